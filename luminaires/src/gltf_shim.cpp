/* SPDX-License-Identifier: Apache-2.0 */
/*
 * tinygltf behind a C interface (gltf_shim.h).  The only file that knows tinygltf.  It maps tinygltf's model to plain C structs and
 * relies on gltf_check.c having checked the document before.  tinygltf never touches the file system here: buffers are served from
 * memory through its callbacks, and images are decoded one by one when something uses them.
 */
#include "gltf_shim.h"

#include <climits>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>
#include <string>
#include <vector>

#include <tiny_gltf.h>

namespace
{

using tinygltf::Value;

/* Everything the C view points to; the view is the first base so that the C pointer is this object's address. */
struct Document : gltf_document {
    tinygltf::Model model;
    std::vector<gltf_bytes> v_buffers;
    std::vector<gltf_view> v_views;
    std::vector<gltf_accessor> v_accessors;
    std::vector<gltf_sampler> v_samplers;
    std::vector<gltf_texture> v_textures;
    std::vector<gltf_material> v_materials;
    std::vector<gltf_mesh> v_meshes;
    std::vector<gltf_node> v_nodes;
    std::vector<gltf_light> v_lights;
    std::vector<gltf_camera> v_cameras;
    std::vector<gltf_scene> v_scenes;
    std::vector<std::vector<gltf_primitive>> primitives;              /* per mesh */
    std::vector<std::vector<std::vector<gltf_morph_target>>> targets; /* per mesh, per primitive */
};

double number(const Value &object, const char *key, double otherwise)
{
    if (!object.IsObject() || !object.Has(key) || !object.Get(key).IsNumber())
        return otherwise;
    return object.Get(key).GetNumberAsDouble();
}

int32_t integer(const Value &object, const char *key, int32_t otherwise)
{
    return static_cast<int32_t>(number(object, key, otherwise));
}

void numbers(const Value &object, const char *key, double *out, size_t count)
{
    if (!object.IsObject() || !object.Has(key) || !object.Get(key).IsArray())
        return;
    const Value &array = object.Get(key);
    for (size_t i = 0; i < count && i < array.ArrayLen(); i++)
        out[i] = array.Get(i).GetNumberAsDouble();
}

const Value *extension(const tinygltf::ExtensionMap &map, const char *name)
{
    auto it = map.find(name);
    return it != map.end() && it->second.IsObject() ? &it->second : nullptr;
}

gltf_texture_use no_texture()
{
    gltf_texture_use use = {};
    use.texture = -1;
    use.strength = 1;
    use.scale[0] = use.scale[1] = 1;
    return use;
}

void texture_transform(gltf_texture_use &use, const Value *transform)
{
    if (!transform)
        return;
    numbers(*transform, "offset", use.offset, 2);
    numbers(*transform, "scale", use.scale, 2);
    use.rotation = number(*transform, "rotation", 0);
    use.coordinates = integer(*transform, "texCoord", use.coordinates);
}

template <class Info> gltf_texture_use texture_use(const Info &info)
{
    gltf_texture_use use = no_texture();
    use.texture = info.index;
    use.coordinates = info.texCoord;
    texture_transform(use, extension(info.extensions, "KHR_texture_transform"));
    return use;
}

/* The same for a textureInfo inside an extension, which tinygltf keeps as a generic value. */
gltf_texture_use texture_use(const Value *object, const char *key)
{
    gltf_texture_use use = no_texture();
    if (!object || !object->Has(key) || !object->Get(key).IsObject())
        return use;
    const Value &info = object->Get(key);
    use.texture = integer(info, "index", -1);
    use.coordinates = integer(info, "texCoord", 0);
    if (info.Has("extensions") && info.Get("extensions").IsObject() && info.Get("extensions").Has("KHR_texture_transform"))
        texture_transform(use, &info.Get("extensions").Get("KHR_texture_transform"));
    return use;
}

void copy(const std::vector<double> &from, double *to, size_t count)
{
    for (size_t i = 0; i < count && i < from.size(); i++)
        to[i] = from[i];
}

void layers(const tinygltf::Material &from, gltf_material &to)
{
    const Value *e = extension(from.extensions, "KHR_materials_specular");
    to.specular = e ? number(*e, "specularFactor", 1) : 1;
    for (double &c : to.specular_color)
        c = 1;
    if (e)
        numbers(*e, "specularColorFactor", to.specular_color, 3);
    to.specular_texture = texture_use(e, "specularTexture");
    to.specular_color_texture = texture_use(e, "specularColorTexture");
    e = extension(from.extensions, "KHR_materials_clearcoat");
    to.clearcoat = e ? number(*e, "clearcoatFactor", 0) : 0;
    to.clearcoat_roughness = e ? number(*e, "clearcoatRoughnessFactor", 0) : 0;
    to.clearcoat_texture = texture_use(e, "clearcoatTexture");
    to.clearcoat_roughness_texture = texture_use(e, "clearcoatRoughnessTexture");
    to.clearcoat_normal_texture = texture_use(e, "clearcoatNormalTexture");
    if (to.clearcoat_normal_texture.texture >= 0)
        to.clearcoat_normal_texture.strength = number(e->Get("clearcoatNormalTexture"), "scale", 1);
    e = extension(from.extensions, "KHR_materials_sheen");
    if (e)
        numbers(*e, "sheenColorFactor", to.sheen_color, 3);
    to.sheen_roughness = e ? number(*e, "sheenRoughnessFactor", 0) : 0;
    to.sheen_color_texture = texture_use(e, "sheenColorTexture");
    to.sheen_roughness_texture = texture_use(e, "sheenRoughnessTexture");
    e = extension(from.extensions, "KHR_materials_anisotropy");
    to.anisotropy = e ? number(*e, "anisotropyStrength", 0) : 0;
    to.anisotropy_rotation = e ? number(*e, "anisotropyRotation", 0) : 0;
    to.anisotropy_texture = texture_use(e, "anisotropyTexture");
    e = extension(from.extensions, "KHR_materials_iridescence");
    to.iridescence = e ? number(*e, "iridescenceFactor", 0) : 0;
    to.iridescence_ior = e ? number(*e, "iridescenceIor", 1.3) : 1.3;
    to.iridescence_thickness_min = e ? number(*e, "iridescenceThicknessMinimum", 100) : 100;
    to.iridescence_thickness_max = e ? number(*e, "iridescenceThicknessMaximum", 400) : 400;
    to.iridescence_texture = texture_use(e, "iridescenceTexture");
    to.iridescence_thickness_texture = texture_use(e, "iridescenceThicknessTexture");
}

gltf_material material(const tinygltf::Material &from)
{
    gltf_material to = {};
    to.name = from.name.c_str();
    for (double &c : to.base_color)
        c = 1;
    copy(from.pbrMetallicRoughness.baseColorFactor, to.base_color, 4);
    to.metallic = from.pbrMetallicRoughness.metallicFactor;
    to.roughness = from.pbrMetallicRoughness.roughnessFactor;
    to.base_texture = texture_use(from.pbrMetallicRoughness.baseColorTexture);
    to.metal_rough_texture = texture_use(from.pbrMetallicRoughness.metallicRoughnessTexture);
    to.normal_texture = texture_use(from.normalTexture);
    to.normal_texture.strength = from.normalTexture.scale;
    to.emissive_texture = texture_use(from.emissiveTexture);
    copy(from.emissiveFactor, to.emissive, 3);
    to.alpha_mode = from.alphaMode == "MASK" ? 1 : from.alphaMode == "BLEND" ? 2 : 0;
    to.alpha_cutoff = from.alphaCutoff;
    to.double_sided = from.doubleSided;

    const Value *e = extension(from.extensions, "KHR_materials_emissive_strength");
    to.emissive_strength = e ? number(*e, "emissiveStrength", 1) : 1;
    e = extension(from.extensions, "KHR_materials_ior");
    to.has_ior = e != nullptr;
    to.ior = e ? number(*e, "ior", 1.5) : 1.5;
    e = extension(from.extensions, "KHR_materials_dispersion");
    to.dispersion = e ? number(*e, "dispersion", 0) : 0;
    e = extension(from.extensions, "KHR_materials_transmission");
    to.transmission = e ? number(*e, "transmissionFactor", 0) : 0;
    to.transmission_texture = texture_use(e, "transmissionTexture");
    e = extension(from.extensions, "KHR_materials_volume");
    to.has_volume = e != nullptr;
    to.thickness = e ? number(*e, "thicknessFactor", 0) : 0;
    to.thickness_texture = texture_use(e, "thicknessTexture");
    to.attenuation_distance = e ? number(*e, "attenuationDistance", INFINITY) : INFINITY;
    for (double &c : to.attenuation_color)
        c = 1;
    if (e)
        numbers(*e, "attenuationColor", to.attenuation_color, 3);
    e = extension(from.extensions, "KHR_materials_diffuse_transmission");
    to.diffuse_transmission = e ? number(*e, "diffuseTransmissionFactor", 0) : 0;
    for (double &c : to.diffuse_transmission_color)
        c = 1;
    if (e)
        numbers(*e, "diffuseTransmissionColorFactor", to.diffuse_transmission_color, 3);
    to.diffuse_transmission_texture = texture_use(e, "diffuseTransmissionTexture");
    to.diffuse_transmission_color_texture = texture_use(e, "diffuseTransmissionColorTexture");
    layers(from, to);
    to.unlit = from.extensions.count("KHR_materials_unlit") != 0;
    return to;
}

int32_t attribute(const std::map<std::string, int> &attributes, const char *name)
{
    auto it = attributes.find(name);
    return it == attributes.end() ? -1 : it->second;
}

gltf_primitive primitive(const tinygltf::Primitive &from, std::vector<gltf_morph_target> &targets)
{
    gltf_primitive to = {};
    to.mode = from.mode < 0 ? 4 : from.mode;
    to.indices = from.indices;
    to.material = from.material;
    to.position = attribute(from.attributes, "POSITION");
    to.normal = attribute(from.attributes, "NORMAL");
    to.tangent = attribute(from.attributes, "TANGENT");
    to.uv[0] = attribute(from.attributes, "TEXCOORD_0");
    to.uv[1] = attribute(from.attributes, "TEXCOORD_1");
    to.color = attribute(from.attributes, "COLOR_0");
    for (const auto &target : from.targets)
        targets.push_back({attribute(target, "POSITION"), attribute(target, "NORMAL")});
    to.targets = targets.data();
    to.target_count = static_cast<uint32_t>(targets.size());
    return to;
}

gltf_node node(const tinygltf::Node &from)
{
    gltf_node to = {};
    to.name = from.name.c_str();
    to.mesh = from.mesh;
    to.camera = from.camera;
    to.skin = from.skin;
    to.light = -1;
    if (const Value *e = extension(from.extensions, "KHR_lights_punctual"))
        to.light = integer(*e, "light", -1);
    to.profile = -1;
    to.profile_multiplier = 1;
    for (double &c : to.profile_color)
        c = 1;
    if (const Value *e = extension(from.extensions, "EXT_lights_ies")) {
        to.profile = integer(*e, "light", -1);
        to.profile_multiplier = number(*e, "multiplier", 1);
        if (e->Has("color") && e->Get("color").IsArray() && e->Get("color").ArrayLen() == 3)
            for (int i = 0; i < 3; i++)
                to.profile_color[i] = e->Get("color").Get(i).GetNumberAsDouble();
    }
    to.children = from.children.data();
    to.child_count = static_cast<uint32_t>(from.children.size());
    to.has_matrix = from.matrix.size() == 16;
    copy(from.matrix, to.matrix, 16);
    copy(from.translation, to.translation, 3);
    to.rotation[3] = 1;
    copy(from.rotation, to.rotation, 4);
    to.scale[0] = to.scale[1] = to.scale[2] = 1;
    copy(from.scale, to.scale, 3);
    to.weights = from.weights.data();
    to.weight_count = static_cast<uint32_t>(from.weights.size());
    to.instance_translation = to.instance_rotation = to.instance_scale = -1;
    if (const Value *e = extension(from.extensions, "EXT_mesh_gpu_instancing")) {
        if (e->Has("attributes") && e->Get("attributes").IsObject()) {
            const Value &a = e->Get("attributes");
            to.instance_translation = integer(a, "TRANSLATION", -1);
            to.instance_rotation = integer(a, "ROTATION", -1);
            to.instance_scale = integer(a, "SCALE", -1);
            to.instanced = to.instance_translation >= 0 || to.instance_rotation >= 0 || to.instance_scale >= 0;
        }
    }
    return to;
}

gltf_light light(const tinygltf::Light &from)
{
    gltf_light to = {};
    to.name = from.name.c_str();
    to.kind = from.type == "spot" ? 1 : from.type == "directional" ? 2 : 0;
    for (double &c : to.color)
        c = 1;
    copy(from.color, to.color, 3);
    to.intensity = from.intensity;
    to.inner = from.spot.innerConeAngle;
    to.outer = from.spot.outerConeAngle;
    return to;
}

gltf_accessor accessor(const tinygltf::Accessor &from)
{
    gltf_accessor to = {};
    to.view = from.bufferView;
    to.offset = from.byteOffset;
    to.count = from.count;
    to.component_type = from.componentType;
    to.components = tinygltf::GetNumComponentsInType(static_cast<uint32_t>(from.type));
    to.normalized = from.normalized;
    if (from.sparse.isSparse) {
        to.sparse_count = static_cast<uint64_t>(from.sparse.count);
        to.sparse_index_view = from.sparse.indices.bufferView;
        to.sparse_index_type = from.sparse.indices.componentType;
        to.sparse_index_offset = static_cast<uint64_t>(from.sparse.indices.byteOffset);
        to.sparse_value_view = from.sparse.values.bufferView;
        to.sparse_value_offset = static_cast<uint64_t>(from.sparse.values.byteOffset);
    }
    return to;
}

template <class T> void expose(std::vector<T> &items, T *&data, uint32_t &count)
{
    data = items.data();
    count = static_cast<uint32_t>(items.size());
}

void fill(Document &d)
{
    const tinygltf::Model &m = d.model;
    for (const auto &b : m.buffers)
        d.v_buffers.push_back({b.data.data(), b.data.size()});
    for (const auto &v : m.bufferViews)
        d.v_views.push_back({v.buffer, v.byteOffset, v.byteLength, v.byteStride});
    for (const auto &a : m.accessors)
        d.v_accessors.push_back(accessor(a));
    for (const auto &s : m.samplers)
        d.v_samplers.push_back({s.magFilter, s.minFilter, s.wrapS, s.wrapT});
    for (const auto &t : m.textures)
        d.v_textures.push_back({t.sampler, t.source});
    for (const auto &from : m.materials)
        d.v_materials.push_back(material(from));
    d.primitives.resize(m.meshes.size());
    d.targets.resize(m.meshes.size());
    for (size_t i = 0; i < m.meshes.size(); i++) {
        const tinygltf::Mesh &mesh = m.meshes[i];
        d.targets[i].resize(mesh.primitives.size());
        for (size_t j = 0; j < mesh.primitives.size(); j++)
            d.primitives[i].push_back(primitive(mesh.primitives[j], d.targets[i][j]));
        gltf_mesh to = {};
        to.name = mesh.name.c_str();
        to.primitives = d.primitives[i].data();
        to.primitive_count = static_cast<uint32_t>(d.primitives[i].size());
        to.weights = mesh.weights.data();
        to.weight_count = static_cast<uint32_t>(mesh.weights.size());
        d.v_meshes.push_back(to);
    }
    for (const auto &n : m.nodes)
        d.v_nodes.push_back(node(n));
    for (const auto &l : m.lights)
        d.v_lights.push_back(light(l));
    for (const auto &c : m.cameras)
        d.v_cameras.push_back({c.name.c_str(), c.type == "perspective", c.perspective.yfov});
    for (const auto &s : m.scenes)
        d.v_scenes.push_back({s.nodes.data(), static_cast<uint32_t>(s.nodes.size())});

    expose(d.v_buffers, d.buffers, d.buffer_count);
    expose(d.v_views, d.views, d.view_count);
    expose(d.v_accessors, d.accessors, d.accessor_count);
    expose(d.v_samplers, d.samplers, d.sampler_count);
    expose(d.v_textures, d.textures, d.texture_count);
    expose(d.v_materials, d.materials, d.material_count);
    expose(d.v_meshes, d.meshes, d.mesh_count);
    expose(d.v_nodes, d.nodes, d.node_count);
    expose(d.v_lights, d.lights, d.light_count);
    expose(d.v_cameras, d.cameras, d.camera_count);
    expose(d.v_scenes, d.scenes, d.scene_count);
    d.scene = m.defaultScene >= 0 ? m.defaultScene : m.scenes.empty() ? -1 : 0;
}

/* tinygltf's file system: the buffers in memory, under the names that gltf_file.c put in the document ("0", "1", ...). */
struct Memory {
    const gltf_bytes *buffers;
    uint32_t count;
};

const gltf_bytes *find(const std::string &name, void *user)
{
    const Memory *memory = static_cast<const Memory *>(user);
    char *end = nullptr;
    unsigned long i = std::strtoul(name.c_str(), &end, 10);
    return !name.empty() && *end == 0 && i < memory->count ? &memory->buffers[i] : nullptr;
}

bool exists(const std::string &name, void *user)
{
    return find(name, user) != nullptr;
}

std::string as_is(const std::string &name, void *)
{
    return name;
}

bool read(std::vector<unsigned char> *out, std::string *, const std::string &name, void *user)
{
    const gltf_bytes *bytes = find(name, user);
    if (!bytes)
        return false;
    out->assign(bytes->data, bytes->data + bytes->size);
    return true;
}

bool refuse_to_write(std::string *, const std::string &, const std::vector<unsigned char> &, void *)
{
    return false;
}

/* tinygltf's messages end in newlines; ours are one line. */
std::string one_line(std::string text)
{
    while (!text.empty() && (text.back() == '\n' || text.back() == ' '))
        text.pop_back();
    for (char &c : text)
        if (static_cast<unsigned char>(c) < 0x20)
            c = ' ';
    return text.empty() ? "not a glTF 2.0 document" : text;
}

} // namespace

lmg_result gltf_document_parse(const char *json, size_t size, const gltf_bytes *buffers, uint32_t buffer_count, gltf_document **out,
                               lmg_error *err)
{
    *out = nullptr;
    try {
        if (size > UINT_MAX)
            return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "the JSON part is larger than 4 GB");
        auto document = std::make_unique<Document>();
        Memory memory = {buffers, buffer_count};
        tinygltf::TinyGLTF loader;
        tinygltf::FsCallbacks files = {exists, as_is, read, refuse_to_write, &memory};
        loader.SetFsCallbacks(files);
        std::string error, warning;
        if (!loader.LoadASCIIFromString(&document->model, &error, &warning, json, static_cast<unsigned int>(size), ""))
            return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%.300s", one_line(error).c_str());
        fill(*document);
        *out = document.release();
        return LMG_OK;
    } catch (const std::bad_alloc &) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
    } catch (const std::exception &e) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%.300s", one_line(e.what()).c_str());
    } catch (...) {
        return lmg_fail(err, LMG_ERROR_INTERNAL, "unknown exception in tinygltf");
    }
}

void gltf_document_free(gltf_document *document)
{
    try {
        delete static_cast<Document *>(document);
    } catch (...) {
    }
}

lmg_result gltf_image_decode(const uint8_t *bytes, size_t size, uint32_t *width, uint32_t *height, int *bits, void **pixels,
                             lmg_error *err)
{
    *pixels = nullptr;
    try {
        if (size > INT_MAX)
            return lmg_fail(err, LMG_ERROR_INPUT, "the image file is larger than 2 GB");
        tinygltf::Image image;
        std::string error, warning;
        if (!tinygltf::LoadImageData(&image, 0, &error, &warning, 0, 0, bytes, static_cast<int>(size), nullptr))
            return lmg_fail(err, LMG_ERROR_INPUT, "the picture can't be decoded");
        void *copy = std::malloc(image.image.size());
        if (!copy)
            return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
        std::memcpy(copy, image.image.data(), image.image.size());
        *width = static_cast<uint32_t>(image.width);
        *height = static_cast<uint32_t>(image.height);
        *bits = image.bits;
        *pixels = copy;
        return LMG_OK;
    } catch (const std::bad_alloc &) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
    } catch (...) {
        return lmg_fail(err, LMG_ERROR_INPUT, "the picture can't be decoded");
    }
}
