/* SPDX-License-Identifier: Apache-2.0 */
/*
 * OpenVDB behind a C interface (vdb_shim.h, luminaires/medium.h).  The only file that knows OpenVDB.  A tree's leaves are blocks of
 * 8^3 voxels, the bricks of a lum_grid, and go over one by one; its tiles (constant blocks of the upper levels) are filled in.
 */
#include "vdb_shim.h"

#include <cmath>
#include <fstream>
#include <new>
#include <string>
#include <vector>

#include <openvdb/io/Stream.h>
#include <openvdb/openvdb.h>

namespace
{

using openvdb::Coord;
using openvdb::CoordBBox;

/* Owns the builder until lum_grid_end takes it. */
struct Builder {
    lum_grid_builder *b = nullptr;
    ~Builder()
    {
        lum_grid_cancel(b);
    }
};

const char *const NO_MAP =
    "grid \"%s\" has a map to the world that isn't affine (a camera frustum?); resample it to a plain lattice";

lmg_result read_map(const openvdb::GridBase &grid, const std::string &name, double m[3][4], lmg_error *err)
{
    if (!grid.transform().isLinear())
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED, NO_MAP, name.c_str());
    const openvdb::math::Mat4d a = grid.transform().baseMap()->getAffineMap()->getMat4(); /* rows are vectors: p' = p a */
    double determinant = a(0, 0) * (a(1, 1) * a(2, 2) - a(1, 2) * a(2, 1)) - a(0, 1) * (a(1, 0) * a(2, 2) - a(1, 2) * a(2, 0)) +
                         a(0, 2) * (a(1, 0) * a(2, 1) - a(1, 1) * a(2, 0));
    bool finite = true;
    for (int row = 0; row < 3; row++)
        for (int column = 0; column < 4; column++) {
            m[row][column] = a(column, row);
            finite = finite && std::isfinite(m[row][column]);
        }
    if (!finite || !std::isfinite(determinant) || determinant == 0)
        return lmg_fail(err, LMG_ERROR_INPUT, "grid \"%s\": its map to the world can't be inverted", name.c_str());
    return LMG_OK;
}

/* Goes over the tree's contents: tile(box, value) for each constant block above the leaves, leaf(node) for each leaf. */
template <typename Tree, typename Tile, typename Leaf> lmg_result visit(const Tree &tree, Tile tile, Leaf leaf)
{
    auto t = tree.cbeginValueAll();
    t.setMaxDepth(Tree::ValueAllCIter::LEAF_DEPTH - 1);
    for (; t; ++t) {
        if (t.getValue() == 0)
            continue;
        CoordBBox box;
        t.getBoundingBox(box);
        if (const lmg_result result = tile(box, static_cast<float>(t.getValue())))
            return result;
    }
    for (auto l = tree.cbeginLeaf(); l; ++l)
        if (const lmg_result result = leaf(*l))
            return result;
    return LMG_OK;
}

template <typename Grid>
lmg_result read_voxels(const Grid &grid, lum_interpolation interpolation, double voxel_depth, lum_grid **out, lmg_error *err)
{
    using Tree = typename Grid::TreeType;
    using Node = typename Tree::LeafNodeType;
    static_assert(Node::DIM == LUM_GRID_BRICK, "leaves are bricks");
    const Tree &tree = grid.tree();
    if (!(tree.background() == 0))
        return lmg_fail(err, LMG_ERROR_INPUT, "its background is %g; outside its voxels the density must be 0",
                        static_cast<double>(tree.background()));
    CoordBBox all;
    visit(
        tree,
        [&](const CoordBBox &box, float) {
            all.expand(box);
            return LMG_OK;
        },
        [&](const Node &node) {
            all.expand(node.getNodeBoundingBox());
            return LMG_OK;
        });
    if (all.empty())
        return lmg_fail(err, LMG_ERROR_INPUT, "it has no voxels");
    const int32_t low[3] = {all.min().x(), all.min().y(), all.min().z()}, high[3] = {all.max().x(), all.max().y(), all.max().z()};
    Builder builder;
    if (const lmg_result result = lum_grid_begin(low, high, interpolation, &builder.b, err))
        return result;
    const lmg_result result = visit(
        tree,
        [&](const CoordBBox &box, float value) {
            const int32_t from[3] = {box.min().x(), box.min().y(), box.min().z()},
                          to[3] = {box.max().x(), box.max().y(), box.max().z()};
            return lum_grid_fill(builder.b, from, to, value, err);
        },
        [&](const Node &node) {
            float values[Node::SIZE];
            for (openvdb::Index i = 0; i < Node::SIZE; i++)
                values[i] = static_cast<float>(node.getValue(i));
            const int32_t origin[3] = {node.origin().x(), node.origin().y(), node.origin().z()};
            return lum_grid_put(builder.b, origin, values, err);
        });
    if (result)
        return result;
    lum_grid_builder *b = builder.b;
    builder.b = nullptr;
    return lum_grid_end(b, voxel_depth, out, err);
}

/* The name of the grid to read; messages list what there is. */
lmg_result choose(const openvdb::GridPtrVec &grids, const char *wanted, openvdb::GridBase::Ptr &chosen, lmg_error *err)
{
    std::string list;
    openvdb::GridBase::Ptr only;
    int usable = 0;
    for (const openvdb::GridBase::Ptr &grid : grids) {
        const std::string one = grid->getName();
        list += (list.empty() ? "\"" : ", \"") + one + "\"";
        if (wanted && *wanted && one == wanted)
            chosen = grid;
        if (grid->isType<openvdb::FloatGrid>() || grid->isType<openvdb::DoubleGrid>()) {
            usable++;
            if (!only || one == "density")
                only = grid;
        }
    }
    if (wanted && *wanted) {
        if (!chosen)
            return lmg_fail(err, LMG_ERROR_INPUT, "no grid is called \"%.60s\"; it has %.200s", wanted,
                            list.empty() ? "none" : list.c_str());
    } else if (usable == 0) {
        return lmg_fail(err, LMG_ERROR_INPUT, "no grid of floating-point numbers; it has %.200s",
                        list.empty() ? "none" : list.c_str());
    } else if (usable > 1 && only->getName() != "density") {
        return lmg_fail(err, LMG_ERROR_INPUT, "several grids; choose one with \"grid\": %.200s", list.c_str());
    } else {
        chosen = only;
    }
    return LMG_OK;
}

lmg_result read_file(const char *path, const char *wanted, lum_interpolation interpolation, double extinction, lum_grid **out,
                     double m[3][4], lmg_error *err)
{
    openvdb::initialize();
    /* OpenVDB doesn't look whether a read came to the end of the file, and goes on with numbers that it hasn't read; a stream that
     * throws there ends this at once. */
    std::ifstream file(path, std::ios::binary);
    if (!file.is_open())
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "can't be opened");
    file.exceptions(std::ios::badbit | std::ios::failbit | std::ios::eofbit);
    openvdb::io::Stream stream(file, false);
    openvdb::GridBase::Ptr grid;
    if (const lmg_result result = choose(*stream.getGrids(), wanted, grid, err))
        return result;
    const std::string name = grid->getName();
    if (grid->getGridClass() == openvdb::GRID_LEVEL_SET)
        return lmg_fail(err, LMG_ERROR_INPUT, "grid \"%s\" is a level set (distances to a surface); a fog volume is wanted",
                        name.c_str());
    if (const lmg_result result = read_map(*grid, name, m, err))
        return result;
    /* the mean length of a voxel's edges, in the file's world */
    double edge = 0;
    for (int a = 0; a < 3; a++)
        edge += std::sqrt(m[0][a] * m[0][a] + m[1][a] * m[1][a] + m[2][a] * m[2][a]) / 3;
    lmg_result result;
    if (const auto floats = openvdb::gridPtrCast<openvdb::FloatGrid>(grid))
        result = read_voxels(*floats, interpolation, extinction * edge, out, err);
    else if (const auto doubles = openvdb::gridPtrCast<openvdb::DoubleGrid>(grid))
        result = read_voxels(*doubles, interpolation, extinction * edge, out, err);
    else
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "grid \"%s\" holds %.40s; density is a grid of float or double", name.c_str(),
                        grid->valueType().c_str());
    if (result && err) {
        const std::string what = err->message;
        return lmg_fail(err, result, "grid \"%s\": %.400s", name.c_str(), what.c_str());
    }
    return result;
}

} // namespace

bool lum_vdb_available(void)
{
    return true;
}

lmg_result lum_grid_read_vdb(const char *path, const char *name, lum_interpolation interpolation, double extinction, lum_grid **out,
                             double index_to_world[3][4], lmg_error *err)
{
    *out = nullptr;
    try {
        return read_file(path, name, interpolation, extinction, out, index_to_world, err);
    } catch (const std::bad_alloc &) {
        return lmg_fail(err, LMG_ERROR_FILE_READ, "is damaged, or larger than this machine's memory");
    } catch (const std::ios_base::failure &) {
        return lmg_fail(err, LMG_ERROR_FILE_READ, "can't be read as OpenVDB: it is truncated, or no OpenVDB file");
    } catch (const std::exception &e) {
        return lmg_fail(err, LMG_ERROR_FILE_READ, "can't be read as OpenVDB: %.300s", e.what());
    } catch (...) {
        return lmg_fail(err, LMG_ERROR_FILE_READ, "can't be read as OpenVDB");
    }
}

lmg_result lum_vdb_write(const char *path, const char *name, const int32_t low[3], const uint32_t size[3], const float *values,
                         const double index_to_world[3][4], lmg_error *err)
{
    try {
        openvdb::initialize();
        openvdb::FloatGrid::Ptr grid = openvdb::FloatGrid::create(0.0f);
        openvdb::math::Mat4d m = openvdb::math::Mat4d::identity();
        for (int row = 0; row < 3; row++)
            for (int column = 0; column < 4; column++)
                m(column, row) = index_to_world[row][column];
        grid->setTransform(openvdb::math::Transform::createLinearTransform(m));
        grid->setName(name);
        grid->setGridClass(openvdb::GRID_FOG_VOLUME);
        openvdb::FloatGrid::Accessor accessor = grid->getAccessor();
        const float *v = values;
        for (uint32_t x = 0; x < size[0]; x++)
            for (uint32_t y = 0; y < size[1]; y++)
                for (uint32_t z = 0; z < size[2]; z++, v++)
                    if (*v != 0)
                        accessor.setValue(Coord(low[0] + static_cast<int32_t>(x), low[1] + static_cast<int32_t>(y),
                                                low[2] + static_cast<int32_t>(z)),
                                          *v);
        openvdb::io::File(path).write({grid});
        return LMG_OK;
    } catch (const std::bad_alloc &) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
    } catch (const std::exception &e) {
        return lmg_fail(err, LMG_ERROR_FILE_WRITE, "%s: can't be written: %.300s", path, e.what());
    } catch (...) {
        return lmg_fail(err, LMG_ERROR_FILE_WRITE, "%s: can't be written", path);
    }
}
