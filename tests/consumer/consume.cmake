# Installs the library to a temporary prefix, moves that elsewhere, and builds programs against it as a stranger would: by CMake package, by
# pkg-config, and the header alone in C17 and C++17.  Run by CTest:
#   cmake -DBUILD=build -DSOURCE=tests/consumer -DMAKE_BOX=program -DCC= -DCXX= -DPKG_CONFIG= -DFLAGS= -DGENERATOR= -DLIBDIR= -P consume.cmake
set(work ${BUILD}/tests/consumer-work)
file(REMOVE_RECURSE ${work})
file(MAKE_DIRECTORY ${work})

function(run name)
  execute_process(COMMAND ${ARGN} WORKING_DIRECTORY ${work} RESULT_VARIABLE code OUTPUT_VARIABLE out ERROR_VARIABLE err)
  if(NOT code EQUAL 0)
    message(FATAL_ERROR "${name} failed (${code}): ${ARGN}\n${out}${err}")
  endif()
  set(out "${out}" PARENT_SCOPE)
endfunction()

function(expect_radiance name)
  run("${name}" ${ARGN} ${work}/lamp.box.exr)
  # 1.5, 0.9 and (1 - 0.2126 * 1.5 - 0.7152 * 0.9) / 0.0722 = 0.518283 of 100 cd/m2; the fluxes are sums of 2^-20 units and floats: 1e-3 is
  # 10^-5 of them, above float's 6e-8 and below what any mistake would make
  if(NOT out STREQUAL "150.000 90.000 51.828 cd/m2\n")
    message(FATAL_ERROR "${name} printed \"${out}\"")
  endif()
endfunction()

separate_arguments(flags UNIX_COMMAND "${FLAGS}")
run("the box" ${MAKE_BOX} ${work}/lamp.box.exr)
run("install" ${CMAKE_COMMAND} --install ${BUILD} --prefix ${work}/first --component lumigraph)
file(RENAME ${work}/first ${work}/installed) # an installed tree may be moved

run("configuring with the CMake package" ${CMAKE_COMMAND} -G ${GENERATOR} -S ${SOURCE} -B ${work}/build -DCMAKE_PREFIX_PATH=${work}/installed
  -DCMAKE_C_COMPILER=${CC} "-DCMAKE_C_FLAGS=${FLAGS}" -DCMAKE_BUILD_TYPE=Release)
load_cache(${work}/build READ_WITH_PREFIX found_ Lumigraph_DIR)
if(NOT found_Lumigraph_DIR STREQUAL "${work}/installed/${LIBDIR}/cmake/Lumigraph")
  message(FATAL_ERROR "another copy of the package was found: ${found_Lumigraph_DIR}")
endif()
run("building with the CMake package" ${CMAKE_COMMAND} --build ${work}/build)
expect_radiance("the consumer built with CMake" ${work}/build/consumer)

set(ENV{PKG_CONFIG_PATH} ${work}/installed/${LIBDIR}/pkgconfig)
run("pkg-config --cflags" ${PKG_CONFIG} --cflags lumigraph)
separate_arguments(cflags UNIX_COMMAND "${out}")
run("pkg-config --libs" ${PKG_CONFIG} --libs lumigraph)
separate_arguments(libs UNIX_COMMAND "${out}")
set(path -Wl,-rpath,${work}/installed/${LIBDIR})
run("building with pkg-config" ${CC} -std=c17 ${flags} ${cflags} ${SOURCE}/consumer.c -o ${work}/consumer_pc ${libs} ${path})
expect_radiance("the consumer built with pkg-config" ${work}/consumer_pc)

set(strict -Wall -Wextra -Wpedantic -Werror)
run("the header alone in C17" ${CC} -std=c17 ${strict} ${flags} ${cflags} ${SOURCE}/header_alone.c -o ${work}/alone_c ${libs} ${path})
run("the C17 program" ${work}/alone_c)
run("the header alone in C++17" ${CXX} -std=c++17 ${strict} ${flags} ${cflags} ${SOURCE}/header_alone.cpp -o ${work}/alone_cxx ${libs} ${path})
run("the C++17 program" ${work}/alone_cxx)

# The header mustn't lean on what the project's own build defines: as strict ISO C without POSIX, too.
run("the header in strict ISO C" ${CC} -std=c17 -U_POSIX_C_SOURCE ${strict} ${cflags} -fsyntax-only ${SOURCE}/header_alone.c)
message(STATUS "the installed library works by CMake package, by pkg-config, in C17 and in C++17")
