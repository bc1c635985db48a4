/*  scene_gltf.cc - glTF files by tinygltf, for scene.c; the only C++ file of the examples

    tinygltf parses the JSON and loads buffers; whatever it hands over is checked here again before it is used:
    every index, every accessor's range in its view and its buffer. Images are never decoded. */
#ifdef EX_TINYGLTF
#include "mesh.h"
#include "scene.h"
#include <tiny_gltf.h>
#include <algorithm>
#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

struct bad : std::runtime_error { explicit bad(const std::string &s) : std::runtime_error(s) {} };

std::string text(const char *format, ...)
{
   char line[EX_ERROR];
   va_list list;
   va_start(list, format);
   vsnprintf(line, sizeof line, format, list);
   va_end(list);
   return line;
}
int report(char *error, const char *path, const std::string &what)
{
   std::string line = what.substr(0, what.find('\n'));
   if (error) snprintf(error, EX_ERROR, "%.120s: %s", path, line.c_str());
   return 0;
}
template <class T> T *keep(const std::vector<T> &v) /* as a block for free() */
{
   T *p = (T *)malloc(v.size() * sizeof(T) + 1);
   if (!p) throw std::bad_alloc();
   if (!v.empty()) memcpy(p, v.data(), v.size() * sizeof(T));
   return p;
}
char *keep(const std::string &s)
{
   char *p = (char *)malloc(s.size() + 1);
   if (!p) throw std::bad_alloc();
   memcpy(p, s.c_str(), s.size() + 1);
   return p;
}
bool no_image(tinygltf::Image *, const int, std::string *, std::string *, int, int, const unsigned char *, int, void *) { return true; }

tinygltf::Model open(const char *path)
{
   tinygltf::Model m;
   tinygltf::TinyGLTF reader;
   std::string error, warning, name = path;
   unsigned char head[4] = {0, 0, 0, 0};
   FILE *f = fopen(path, "rb");
   if (!f) throw bad("cannot be opened");
   size_t n = fread(head, 1, 4, f);
   fclose(f);
   if (n < 4) throw bad("is no glTF file: too short");
   reader.SetImageLoader(no_image, nullptr);
   bool binary = !memcmp(head, "glTF", 4); /* by content: the extension may lie */
   bool ok = binary ? reader.LoadBinaryFromFile(&m, &error, &warning, name) : reader.LoadASCIIFromFile(&m, &error, &warning, name);
   if (!ok) throw bad(error.empty() ? "is no readable glTF file" : error);
   for (const std::string &e : m.extensionsRequired)
      if (e != "KHR_mesh_quantization" && e.compare(0, 13, "KHR_materials") && e.compare(0, 11, "KHR_texture") && e.compare(0, 11, "EXT_texture"))
         throw bad("needs the extension " + e + ", which is not supported; export it without compression");
   return m;
}

/* ------------------------------------------------- accessors */
unsigned component_bytes(int type) { return type == 5120 || type == 5121 ? 1 : type == 5122 || type == 5123 ? 2 : type == 5125 || type == 5126 ? 4 : 0; }
unsigned width_of(int type) { return type == TINYGLTF_TYPE_SCALAR ? 1 : type == TINYGLTF_TYPE_VEC2 ? 2 : type == TINYGLTF_TYPE_VEC3 ? 3 : type == TINYGLTF_TYPE_VEC4 ? 4 : type == TINYGLTF_TYPE_MAT4 ? 16 : 0; }
double component(const unsigned char *p, int type, bool normalised)
{
   float f;
   uint32_t u;
   uint16_t h;
   switch (type) {
   case 5126: memcpy(&f, p, 4); return (double)f;
   case 5125: memcpy(&u, p, 4); return u;
   case 5123: memcpy(&h, p, 2); return normalised ? h / 65535.0 : h;
   case 5122: memcpy(&h, p, 2); return normalised ? std::max((int16_t)h / 32767.0, -1.0) : (double)(int16_t)h;
   case 5120: return normalised ? std::max((signed char)*p / 127.0, -1.0) : (double)(signed char)*p;
   default:   return normalised ? *p / 255.0 : (double)*p;
   }
}
/* count elements of width components from a view, each range checked */
void view_read(const tinygltf::Model &m, int view, size_t offset, size_t count, unsigned width, int type, bool normalised, std::vector<double> &out, const char *what)
{
   unsigned size = component_bytes(type);
   if (view < 0 || (size_t)view >= m.bufferViews.size()) throw bad(text("%s: buffer view %d of %lu", what, view, (unsigned long)m.bufferViews.size()));
   const tinygltf::BufferView &v = m.bufferViews[(size_t)view];
   if (v.buffer < 0 || (size_t)v.buffer >= m.buffers.size()) throw bad(text("%s: buffer %d of %lu", what, v.buffer, (unsigned long)m.buffers.size()));
   const std::vector<unsigned char> &b = m.buffers[(size_t)v.buffer].data;
   size_t element = (size_t)size * width, stride = v.byteStride ? v.byteStride : element;
   if (v.byteOffset > b.size() || v.byteLength > b.size() - v.byteOffset) throw bad(text("%s: its buffer view ends beyond the buffer of %lu bytes", what, (unsigned long)b.size()));
   if (count && (offset > v.byteLength || element > v.byteLength - offset || (count - 1) > (v.byteLength - offset - element) / stride))
      throw bad(text("%s: %lu elements do not fit its buffer view of %lu bytes", what, (unsigned long)count, (unsigned long)v.byteLength));
   const unsigned char *p = b.data() + v.byteOffset + offset;
   out.resize(count * width);
   for (size_t i = 0; i < count; i++) for (unsigned c = 0; c < width; c++) out[i * width + c] = component(p + i * stride + c * size, type, normalised);
}
std::vector<double> read(const tinygltf::Model &m, int index, unsigned width, const char *what)
{
   if (index < 0 || (size_t)index >= m.accessors.size()) throw bad(text("%s: accessor %d of %lu", what, index, (unsigned long)m.accessors.size()));
   const tinygltf::Accessor &a = m.accessors[(size_t)index];
   unsigned w = width_of(a.type);
   std::vector<double> out;
   if (!component_bytes(a.componentType) || w != width) throw bad(text("%s: accessor %d has the wrong type", what, index));
   if (a.bufferView < 0) {
      if (!a.sparse.isSparse) throw bad(text("%s: accessor %d has no data (compressed?)", what, index));
      if (a.count > (size_t)1 << 28) throw bad(text("%s: accessor %d has %lu elements", what, index, (unsigned long)a.count));
      out.assign(a.count * w, 0.0);
   } else view_read(m, a.bufferView, a.byteOffset, a.count, w, a.componentType, a.normalized, out, what);
   if (a.sparse.isSparse) {
      std::vector<double> where, value;
      size_t n = a.sparse.count < 0 ? 0 : (size_t)a.sparse.count;
      if (!component_bytes(a.sparse.indices.componentType)) throw bad(text("%s: sparse indices of a wrong type", what));
      view_read(m, a.sparse.indices.bufferView, (size_t)std::max(0, a.sparse.indices.byteOffset), n, 1, a.sparse.indices.componentType, false, where, what);
      view_read(m, a.sparse.values.bufferView, (size_t)std::max(0, a.sparse.values.byteOffset), n, w, a.componentType, a.normalized, value, what);
      for (size_t i = 0; i < n; i++) {
         if (!(where[i] >= 0 && where[i] < (double)a.count)) throw bad(text("%s: sparse index %g of %lu", what, where[i], (unsigned long)a.count));
         for (unsigned c = 0; c < w; c++) out[(size_t)where[i] * w + c] = value[i * w + c];
      }
   }
   return out;
}

/* ------------------------------------------------- nodes */
struct nodes {
   std::vector<int32_t> parent;
   std::vector<std::string> name;
   std::vector<float> rest;     /* (n,10) */
   std::vector<double> local;   /* (n,12): the file's matrix itself where it gives one, TRS otherwise */
   std::vector<double> world;   /* (n,12) */
};
void matrix_trs(const double *m, float *trs) /* (12) -> translation, rotation, scale; shear is lost */
{
   double r[9], s[3], q[4], l;
   for (int c = 0; c < 3; c++) {
      s[c] = std::sqrt(m[c] * m[c] + m[4 + c] * m[4 + c] + m[8 + c] * m[8 + c]);
      for (int i = 0; i < 3; i++) r[3 * i + c] = s[c] > 0 ? m[4 * i + c] / s[c] : (i == c);
   }
   double det = r[0] * (r[4] * r[8] - r[5] * r[7]) - r[1] * (r[3] * r[8] - r[5] * r[6]) + r[2] * (r[3] * r[7] - r[4] * r[6]);
   if (det < 0) { s[0] = -s[0]; for (int i = 0; i < 3; i++) r[3 * i] = -r[3 * i]; }
   double t = r[0] + r[4] + r[8];
   if (t > 0) { q[3] = 1 + t; q[0] = r[7] - r[5]; q[1] = r[2] - r[6]; q[2] = r[3] - r[1]; }
   else {
      int i = r[0] > r[4] ? (r[0] > r[8] ? 0 : 2) : (r[4] > r[8] ? 1 : 2), j = (i + 1) % 3, k = (i + 2) % 3;
      q[i] = 1 + r[4 * i] - r[4 * j] - r[4 * k];
      q[j] = r[3 * j + i] + r[3 * i + j];
      q[k] = r[3 * k + i] + r[3 * i + k];
      q[3] = r[3 * k + j] - r[3 * j + k];
   }
   l = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
   for (int i = 0; i < 3; i++) { trs[i] = (float)m[4 * i + 3]; trs[7 + i] = (float)s[i]; }
   for (int i = 0; i < 4; i++) trs[3 + i] = l > 0 ? (float)(q[i] / l) : (i == 3);
}
nodes read_nodes(const tinygltf::Model &m)
{
   nodes r;
   size_t n = m.nodes.size();
   r.parent.assign(n, -1);
   r.rest.resize(10 * n);
   r.local.resize(12 * n);
   r.world.resize(12 * n);
   for (size_t i = 0; i < n; i++) {
      const tinygltf::Node &d = m.nodes[i];
      float *t = &r.rest[10 * i];
      r.name.push_back(d.name.empty() ? text("node%lu", (unsigned long)i) : d.name);
      for (int c : d.children) {
         if (c < 0 || (size_t)c >= n) throw bad(text("node %lu has child %d of %lu", (unsigned long)i, c, (unsigned long)n));
         if (r.parent[(size_t)c] >= 0 || (size_t)c == i) throw bad(text("node %d has two parents", c));
         r.parent[(size_t)c] = (int32_t)i;
      }
      for (int k = 0; k < 10; k++) t[k] = k < 6 ? 0.0f : 1.0f;
      if (d.matrix.size() == 16) {
         for (int k = 0; k < 12; k++) r.local[12 * i + (size_t)k] = d.matrix[(size_t)(4 * (k % 4) + k / 4)];
         matrix_trs(&r.local[12 * i], t);
      } else {
         if (d.translation.size() == 3) for (size_t k = 0; k < 3; k++) t[k] = (float)d.translation[k];
         if (d.rotation.size() == 4) for (size_t k = 0; k < 4; k++) t[3 + k] = (float)d.rotation[k];
         if (d.scale.size() == 3) for (size_t k = 0; k < 3; k++) t[7 + k] = (float)d.scale[k];
         ex__matrix(t, &r.local[12 * i]);
      }
   }
   std::vector<char> done(n, 0);
   for (size_t i = 0; i < n; i++) {
      std::vector<size_t> up;
      for (int32_t k = (int32_t)i; k >= 0 && !done[(size_t)k]; k = r.parent[(size_t)k]) {
         up.push_back((size_t)k);
         if (up.size() > n) throw bad("the nodes' children form a circle");
      }
      for (; !up.empty(); up.pop_back()) {
         size_t k = up.back();
         if (r.parent[k] < 0) memcpy(&r.world[12 * k], &r.local[12 * k], 12 * sizeof(double));
         else ex__multiply(&r.world[12 * (size_t)r.parent[k]], &r.local[12 * k], &r.world[12 * k]);
         done[k] = 1;
      }
   }
   return r;
}

/* ------------------------------------------------- skins and meshes */
struct skin_bind { std::vector<int> joints; std::vector<double> bind; }; /* nodes; (n,12) inverse bind */
skin_bind read_skin(const tinygltf::Model &m, size_t index)
{
   const tinygltf::Skin &s = m.skins[index];
   skin_bind r;
   r.joints = s.joints;
   if (s.joints.empty()) throw bad(text("skin %lu has no joints", (unsigned long)index));
   std::vector<char> seen(m.nodes.size(), 0);
   for (int j : s.joints) {
      if (j < 0 || (size_t)j >= m.nodes.size()) throw bad(text("skin %lu: joint node %d of %lu", (unsigned long)index, j, (unsigned long)m.nodes.size()));
      if (seen[(size_t)j]++) throw bad(text("skin %lu names node %d twice", (unsigned long)index, j));
   }
   std::vector<double> raw;
   if (s.inverseBindMatrices >= 0) raw = read(m, s.inverseBindMatrices, 16, "inverseBindMatrices");
   if (s.inverseBindMatrices >= 0 && raw.size() < 16 * s.joints.size()) throw bad(text("skin %lu: %lu inverse bind matrices for %lu joints", (unsigned long)index, (unsigned long)(raw.size() / 16), (unsigned long)s.joints.size()));
   for (size_t j = 0; j < s.joints.size(); j++) for (size_t k = 0; k < 12; k++) /* column-major there; absent: the identity */
      r.bind.push_back(raw.empty() ? (k % 5 == 0) : raw[16 * j + 4 * (k % 4) + k / 4]);
   return r;
}
struct builder {
   std::vector<float> position, normal, weight;
   std::vector<uint32_t> joint, triangle;
   std::vector<ex_range> range;
   size_t influences;
   bool normals;                /* every primitive has them */
   builder() : influences(0), normals(true) {}
   ~builder() { for (ex_range &r : range) free(r.name); }
};
void add_triangles(builder &b, const std::vector<double> &index, int mode, size_t base, size_t vertices, const char *what)
{
   size_t n = index.size();
   for (double i : index) if (!(i >= 0 && i < (double)vertices)) throw bad(text("%s: index %g of %lu vertices", what, i, (unsigned long)vertices));
   auto add = [&](size_t x, size_t y, size_t z) {
      b.triangle.push_back((uint32_t)(base + (size_t)index[x]));
      b.triangle.push_back((uint32_t)(base + (size_t)index[y]));
      b.triangle.push_back((uint32_t)(base + (size_t)index[z]));
   };
   if (mode == TINYGLTF_MODE_TRIANGLES) for (size_t i = 0; i + 2 < n; i += 3) add(i, i + 1, i + 2);
   else if (mode == TINYGLTF_MODE_TRIANGLE_STRIP) for (size_t i = 0; i + 2 < n; i++) { if (i & 1) add(i + 1, i, i + 2); else add(i, i + 1, i + 2); }
   else for (size_t i = 1; i + 1 < n; i++) add(0, i, i + 1);
}
/* one primitive; slot maps the skin's joints to the scene's, fix (12) brings it into the first skin's space */
void add_primitive(builder &b, const tinygltf::Model &m, const tinygltf::Mesh &mesh, const tinygltf::Primitive &p, const std::vector<uint32_t> &slot, const double *fix)
{
   const char *what = mesh.name.empty() ? "mesh" : mesh.name.c_str();
   auto attribute = [&](const std::string &name) { auto it = p.attributes.find(name); return it == p.attributes.end() ? -1 : it->second; };
   int mode = p.mode < 0 ? TINYGLTF_MODE_TRIANGLES : p.mode;
   if (mode != TINYGLTF_MODE_TRIANGLES && mode != TINYGLTF_MODE_TRIANGLE_STRIP && mode != TINYGLTF_MODE_TRIANGLE_FAN) return; /* points, lines */
   if (attribute("POSITION") < 0) return;
   std::vector<double> x = read(m, attribute("POSITION"), 3, what), n;
   size_t count = x.size() / 3, base = b.position.size() / 3, first = b.triangle.size() / 3, sets = 0;
   if (!count) return;
   while (attribute("JOINTS_" + std::to_string(sets)) >= 0 && attribute("WEIGHTS_" + std::to_string(sets)) >= 0) sets++;
   if (!sets) throw bad(text("%s: is skinned but a primitive has no JOINTS_0 and WEIGHTS_0", what));
   if (sets > 16) throw bad(text("%s: has %lu sets of weights", what, (unsigned long)sets));
   if (base + count > 0x7fffffff) throw bad("has too many vertices");
   if (4 * sets > b.influences) { /* widen the rows so far */
      size_t wide = 4 * sets;
      std::vector<float> w(base * wide, 0.0f);
      std::vector<uint32_t> j(base * wide, 0);
      for (size_t i = 0; i < base; i++) for (size_t k = 0; k < b.influences; k++) { w[i * wide + k] = b.weight[i * b.influences + k]; j[i * wide + k] = b.joint[i * b.influences + k]; }
      b.weight.swap(w);
      b.joint.swap(j);
      b.influences = wide;
   }
   b.weight.resize((base + count) * b.influences, 0.0f);
   b.joint.resize((base + count) * b.influences, 0);
   for (size_t s = 0; s < sets; s++) {
      std::vector<double> j = read(m, attribute("JOINTS_" + std::to_string(s)), 4, what), w = read(m, attribute("WEIGHTS_" + std::to_string(s)), 4, what);
      if (j.size() != 4 * count || w.size() != 4 * count) throw bad(text("%s: JOINTS_%lu or WEIGHTS_%lu do not have %lu rows", what, (unsigned long)s, (unsigned long)s, (unsigned long)count));
      for (size_t i = 0; i < count; i++) for (size_t k = 0; k < 4; k++) {
         size_t at = (base + i) * b.influences + 4 * s + k;
         b.weight[at] = (float)w[4 * i + k];
         if (b.weight[at] == 0) continue; /* exporters leave anything beside a zero weight */
         if (!(j[4 * i + k] >= 0 && j[4 * i + k] < (double)slot.size())) throw bad(text("%s: vertex %lu is bound to joint %g of %lu", what, (unsigned long)i, j[4 * i + k], (unsigned long)slot.size()));
         b.joint[at] = slot[(size_t)j[4 * i + k]];
      }
   }
   if (attribute("NORMAL") >= 0) {
      n = read(m, attribute("NORMAL"), 3, what);
      if (n.size() != 3 * count) throw bad(text("%s: NORMAL does not have %lu rows", what, (unsigned long)count));
   } else b.normals = false;
   n.resize(3 * count, 0.0);
   for (size_t i = 0; i < count; i++) {
      double d[3], l;
      for (size_t k = 0; k < 3; k++) {
         const double *f = fix + 4 * k;
         /* the identity is kept apart so that positions stay the file's bits */
         b.position.push_back((float)(f[k] == 1 && f[(k + 1) % 3] == 0 && f[(k + 2) % 3] == 0 && f[3] == 0 ? x[3 * i + k] : f[0] * x[3 * i] + f[1] * x[3 * i + 1] + f[2] * x[3 * i + 2] + f[3]));
         d[k] = f[0] * n[3 * i] + f[1] * n[3 * i + 1] + f[2] * n[3 * i + 2];
      }
      l = std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
      for (size_t k = 0; k < 3; k++) b.normal.push_back(l > 0 ? (float)(d[k] / l) : 0.0f);
   }
   std::vector<double> index;
   if (p.indices >= 0) index = read(m, p.indices, 1, what);
   else for (size_t i = 0; i < count; i++) index.push_back((double)i);
   add_triangles(b, index, mode, base, count, what);
   ex_range r;
   r.name = keep(std::string(what));
   r.first_vertex = base;
   r.vertices = count;
   r.first_triangle = first;
   r.triangles = b.triangle.size() / 3 - first;
   b.range.push_back(r);
}
double apart(const double *a, const double *b)
{
   double d = 0, s = 1e-3;
   for (int i = 0; i < 12; i++) { d = std::max(d, std::fabs(a[i] - b[i])); s = std::max(s, std::fabs(a[i])); }
   return d / s;
}
void fill_scene(ex_scene *s, const char *path)
{
   tinygltf::Model m = open(path);
   nodes all = read_nodes(m);
   s->path = keep(std::string(path));
   if (m.meshes.empty()) throw bad("has no mesh");
   std::vector<std::pair<size_t, size_t>> use; /* mesh, skin */
   for (const tinygltf::Node &n : m.nodes) {
      if (n.mesh < 0) continue;
      if ((size_t)n.mesh >= m.meshes.size()) throw bad(text("a node has mesh %d of %lu", n.mesh, (unsigned long)m.meshes.size()));
      if (n.skin < 0) { s->meshes_left_out++; continue; }
      if ((size_t)n.skin >= m.skins.size()) throw bad(text("a node has skin %d of %lu", n.skin, (unsigned long)m.skins.size()));
      std::pair<size_t, size_t> one((size_t)n.mesh, (size_t)n.skin);
      if (std::find(use.begin(), use.end(), one) == use.end()) use.push_back(one);
   }
   if (use.empty()) throw bad(m.skins.empty() ? "is not skinned: it has a mesh but no skin" : "has a skin but no mesh that uses it");
   /* joints: the first skin's, then those that further skins of the same skeleton add */
   builder b;
   std::vector<int> slot_of(m.nodes.size(), -1);
   std::vector<size_t> joint_node;
   std::vector<double> bind;
   std::vector<char> left(use.size(), 1);
   for (bool again = true, first = true; again;) {
      again = false;
      for (size_t u = 0; u < use.size(); u++) {
         if (!left[u]) continue;
         skin_bind k = read_skin(m, use[u].second);
         double fix[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}, back[12], step[12];
         bool shared = first;
         for (size_t j = 0; j < k.joints.size() && !first; j++) { /* bind2 = bind1 fix for every joint that both have */
            int at = slot_of[(size_t)k.joints[j]];
            if (at < 0) continue;
            if (!ex__invert(&bind[12 * (size_t)at], back)) throw bad("inverse bind matrix of joint " + all.name[(size_t)k.joints[j]] + " is singular");
            ex__multiply(back, &k.bind[12 * j], step);
            if (!shared) memcpy(fix, step, sizeof fix);
            else if (apart(fix, step) > 1e-3) throw bad(text("skin %lu binds the joints in another pose than the first skin", (unsigned long)use[u].second));
            shared = true;
         }
         if (!shared) continue;
         const double one[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
         if (apart(fix, one) < 1e-5) memcpy(fix, one, sizeof fix);
         if (!ex__invert(fix, back)) throw bad("an inverse bind matrix is singular");
         std::vector<uint32_t> slot;
         for (size_t j = 0; j < k.joints.size(); j++) {
            int &at = slot_of[(size_t)k.joints[j]];
            if (at < 0) {
               at = (int)joint_node.size();
               joint_node.push_back((size_t)k.joints[j]);
               ex__multiply(&k.bind[12 * j], back, step);
               bind.insert(bind.end(), step, step + 12);
            }
            slot.push_back((uint32_t)at);
         }
         const tinygltf::Mesh &mesh = m.meshes[use[u].first];
         for (const tinygltf::Primitive &p : mesh.primitives) add_primitive(b, m, mesh, p, slot, fix);
         left[u] = 0;
         again = true;
         first = false;
      }
   }
   for (char l : left) s->meshes_left_out += (size_t)l;
   if (b.position.empty()) throw bad("has a skinned mesh without triangles");
   s->joints = joint_node.size();
   std::vector<float> rest, above, inverse;
   std::vector<int32_t> parents;
   s->names = (char **)calloc(s->joints, sizeof *s->names);
   if (!s->names) throw std::bad_alloc();
   for (size_t j = 0; j < s->joints; j++) {
      double a[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
      int32_t k = all.parent[joint_node[j]];
      for (; k >= 0 && slot_of[(size_t)k] < 0; k = all.parent[(size_t)k]) ex__multiply(&all.local[12 * (size_t)k], a, a);
      parents.push_back(k < 0 ? -1 : slot_of[(size_t)k]);
      s->names[j] = keep(all.name[joint_node[j]]);
      for (size_t i = 0; i < 10; i++) rest.push_back(all.rest[10 * joint_node[j] + i]);
      for (size_t i = 0; i < 12; i++) { above.push_back((float)a[i]); inverse.push_back((float)bind[12 * j + i]); }
   }
   s->vertices = b.position.size() / 3;
   s->triangles = b.triangle.size() / 3;
   s->influences = b.influences;
   s->positions = keep(b.position);
   if (b.normals) s->normals = keep(b.normal);
   s->triangle = keep(b.triangle);
   s->skin_joints = keep(b.joint);
   s->skin_weights = keep(b.weight);
   s->rest = keep(rest);
   s->above = keep(above);
   s->inverse_bind = keep(inverse);
   s->parents = keep(parents);
   s->range = keep(b.range);
   s->ranges = b.range.size();
   b.range.clear(); /* the names are the scene's now */
}

/* ------------------------------------------------- bare meshes */
struct bare { std::vector<float> position, normal, uv; std::vector<uint32_t> triangle; bool normals, uvs; };
/* one primitive in the scene's space; world (12). A mirroring transform turns the triangles */
void add_bare(bare &b, const tinygltf::Model &m, const tinygltf::Mesh &mesh, const tinygltf::Primitive &p, const double *world)
{
   const char *what = mesh.name.empty() ? "mesh" : mesh.name.c_str();
   auto attribute = [&](const std::string &name) { auto it = p.attributes.find(name); return it == p.attributes.end() ? -1 : it->second; };
   int mode = p.mode < 0 ? TINYGLTF_MODE_TRIANGLES : p.mode;
   if (mode != TINYGLTF_MODE_TRIANGLES && mode != TINYGLTF_MODE_TRIANGLE_STRIP && mode != TINYGLTF_MODE_TRIANGLE_FAN) return; /* points, lines */
   if (attribute("POSITION") < 0) return;
   std::vector<double> x = read(m, attribute("POSITION"), 3, what), n, t, index;
   size_t count = x.size() / 3, base = b.position.size() / 3, first = b.triangle.size();
   if (base + count > 0x7fffffff) throw bad("has too many vertices");
   if (attribute("NORMAL") >= 0) n = read(m, attribute("NORMAL"), 3, what);
   if (attribute("TEXCOORD_0") >= 0) t = read(m, attribute("TEXCOORD_0"), 2, what);
   b.normals = b.normals && n.size() == 3 * count;
   b.uvs = b.uvs && t.size() == 2 * count;
   n.resize(3 * count, 0.0);
   t.resize(2 * count, 0.0);
   double cross[9], det = 0;
   for (size_t i = 0; i < 3; i++) for (size_t k = 0; k < 3; k++) { /* normals turn with the cofactors */
      size_t a = (i + 1) % 3, c = (i + 2) % 3, e = (k + 1) % 3, f = (k + 2) % 3;
      cross[3 * i + k] = world[4 * a + e] * world[4 * c + f] - world[4 * a + f] * world[4 * c + e];
      if (i == 0) det += world[k] * cross[k];
   }
   for (size_t i = 0; i < count; i++) {
      for (size_t k = 0; k < 3; k++) {
         const double *w = world + 4 * k, *c = cross + 3 * k;
         /* the identity is kept apart so that positions stay the file's bits */
         b.position.push_back((float)(w[k] == 1 && w[(k + 1) % 3] == 0 && w[(k + 2) % 3] == 0 && w[3] == 0 ? x[3 * i + k] : w[0] * x[3 * i] + w[1] * x[3 * i + 1] + w[2] * x[3 * i + 2] + w[3]));
         b.normal.push_back((float)(((det < 0) ? -1 : 1) * (c[0] * n[3 * i] + c[1] * n[3 * i + 1] + c[2] * n[3 * i + 2])));
      }
      for (size_t k = 0; k < 2; k++) b.uv.push_back((float)t[2 * i + k]);
   }
   if (p.indices >= 0) index = read(m, p.indices, 1, what);
   else for (size_t i = 0; i < count; i++) index.push_back((double)i);
   builder one;
   add_triangles(one, index, mode, base, count, what);
   b.triangle.insert(b.triangle.end(), one.triangle.begin(), one.triangle.end());
   if (det < 0) for (size_t i = first; i + 2 < b.triangle.size(); i += 3) std::swap(b.triangle[i + 1], b.triangle[i + 2]);
}
void fill_mesh(ex_mesh *out, const char *path)
{
   tinygltf::Model m = open(path);
   nodes all = read_nodes(m);
   bare b;
   b.normals = b.uvs = true;
   std::vector<char> shown(m.nodes.size(), m.scenes.empty());
   size_t scene = m.defaultScene >= 0 && (size_t)m.defaultScene < m.scenes.size() ? (size_t)m.defaultScene : 0;
   if (!m.scenes.empty()) for (int r : m.scenes[scene].nodes) if (r >= 0 && (size_t)r < shown.size()) shown[(size_t)r] = 1;
   for (size_t i = 0; i < m.nodes.size(); i++) {
      const tinygltf::Node &n = m.nodes[i];
      const double one[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
      int32_t top = (int32_t)i;
      if (n.mesh < 0) continue;
      if ((size_t)n.mesh >= m.meshes.size()) throw bad(text("a node has mesh %d of %lu", n.mesh, (unsigned long)m.meshes.size()));
      while (!shown[(size_t)top] && all.parent[(size_t)top] >= 0) top = all.parent[(size_t)top];
      if (!shown[(size_t)top]) continue; /* another scene's */
      if (n.skin >= 0) out->skinned++;
      for (const tinygltf::Primitive &p : m.meshes[(size_t)n.mesh].primitives) add_bare(b, m, m.meshes[(size_t)n.mesh], p, n.skin >= 0 ? one : &all.world[12 * i]);
   }
   if (b.position.empty()) throw bad("has no mesh in its scene");
   out->vertices = b.position.size() / 3;
   out->triangles = b.triangle.size() / 3;
   out->positions = keep(b.position);
   if (b.normals) out->normals = keep(b.normal);
   if (b.uvs) out->uv = keep(b.uv);
   out->triangle = keep(b.triangle);
}

/* ------------------------------------------------- animations */
size_t choose(const tinygltf::Model &m, const char *which)
{
   size_t n = m.animations.size();
   if (!n) throw bad("has no animation");
   if (!which || !*which) return 0;
   for (size_t i = 0; i < n; i++) if (m.animations[i].name == which) return i;
   for (size_t i = 0; i < n; i++) if (!strcmp(ex_short_name(m.animations[i].name.c_str()), which)) return i;
   char *end;
   unsigned long k = strtoul(which, &end, 10);
   if (!*end && k < n && which[0] >= '0' && which[0] <= '9') return k;
   std::string list;
   for (size_t i = 0; i < n && list.size() < 120; i++) list += std::string(i ? ", " : "") + ex_short_name(m.animations[i].name.c_str());
   throw bad(text("has no animation \"%.40s\" among its %lu: ", which, (unsigned long)n) + list);
}
struct channel { size_t node; int kind; int mode; std::vector<double> time, value; }; /* mode 0 linear 1 step 2 cubic */
void sample(const channel &c, double t, unsigned width, float *out)
{
   size_t n = c.time.size(), k = (size_t)(std::upper_bound(c.time.begin(), c.time.end(), t) - c.time.begin());
   size_t a = k ? k - 1 : 0, b = std::min(k, n - 1);
   double v[4], span = c.time[b] - c.time[a], u = span > 0 ? std::min(1.0, std::max(0.0, (t - c.time[a]) / span)) : 0, l = 0, dot = 0;
   if (c.mode == 2) { /* rows: in-tangent, value, out-tangent */
      const double *p = &c.value[(3 * a + 1) * width], *q = &c.value[(3 * b + 1) * width], *out_a = &c.value[(3 * a + 2) * width], *in_b = &c.value[3 * b * width];
      double u2 = u * u, u3 = u2 * u;
      for (unsigned i = 0; i < width; i++)
         v[i] = (2 * u3 - 3 * u2 + 1) * p[i] + span * (u3 - 2 * u2 + u) * out_a[i] + (3 * u2 - 2 * u3) * q[i] + span * (u3 - u2) * in_b[i];
   } else {
      const double *p = &c.value[a * width], *q = &c.value[b * width];
      double ka = 1 - u, kb = u;
      if (c.mode == 1) { ka = 1; kb = 0; }
      else if (c.kind == 1) { /* the shorter arc */
         for (unsigned i = 0; i < 4; i++) dot += p[i] * q[i];
         double s = dot < 0 ? -1 : 1, angle = std::acos(std::min(1.0, std::fabs(dot)));
         if (angle > 1e-4) { ka = std::sin((1 - u) * angle) / std::sin(angle); kb = std::sin(u * angle) / std::sin(angle); }
         kb *= s;
      }
      if (u == 0) { ka = 1; kb = 0; }
      for (unsigned i = 0; i < width; i++) v[i] = ka * p[i] + kb * q[i];
   }
   if (c.kind == 1) {
      for (unsigned i = 0; i < 4; i++) l += v[i] * v[i];
      l = std::sqrt(l);
      for (unsigned i = 0; i < 4; i++) v[i] = l > 0 ? v[i] / l : (i == 3);
   }
   for (unsigned i = 0; i < width; i++) out[i] = (float)v[i];
}
void fill_clip(ex__clip *out, const char *path, const char *which)
{
   tinygltf::Model m = open(path);
   nodes all = read_nodes(m);
   size_t index = choose(m, which);
   const tinygltf::Animation &a = m.animations[index];
   std::vector<channel> channels;
   std::vector<double> times;
   for (const tinygltf::AnimationChannel &h : a.channels) {
      channel c;
      c.kind = h.target_path == "translation" ? 0 : h.target_path == "rotation" ? 1 : h.target_path == "scale" ? 2 : -1;
      if (c.kind < 0 || h.target_node < 0) continue; /* morph weights, pointers */
      if ((size_t)h.target_node >= m.nodes.size()) throw bad(text("animation moves node %d of %lu", h.target_node, (unsigned long)m.nodes.size()));
      if (h.sampler < 0 || (size_t)h.sampler >= a.samplers.size()) throw bad(text("animation has sampler %d of %lu", h.sampler, (unsigned long)a.samplers.size()));
      const tinygltf::AnimationSampler &s = a.samplers[(size_t)h.sampler];
      unsigned width = c.kind == 1 ? 4 : 3;
      c.node = (size_t)h.target_node;
      c.mode = s.interpolation == "STEP" ? 1 : s.interpolation == "CUBICSPLINE" ? 2 : 0;
      c.time = read(m, s.input, 1, "animation times");
      c.value = read(m, s.output, width, "animation values");
      if (c.time.empty()) continue;
      if (c.value.size() != c.time.size() * width * (c.mode == 2 ? 3 : 1)) throw bad(text("animation has %lu keys but %lu values", (unsigned long)c.time.size(), (unsigned long)(c.value.size() / width)));
      for (size_t i = 0; i < c.time.size(); i++) if (!std::isfinite(c.time[i]) || (i && c.time[i] < c.time[i - 1])) throw bad(text("animation time of key %lu is not ascending", (unsigned long)i));
      for (double v : c.value) if (!std::isfinite(v)) throw bad("animation has a value that is not finite");
      times.insert(times.end(), c.time.begin(), c.time.end());
      channels.push_back(c);
   }
   if (channels.empty()) throw bad("its animation moves no node");
   std::sort(times.begin(), times.end());
   std::vector<float> frames;
   std::vector<double> when;
   for (double t : times) if (when.empty() || t - when.back() > 1e-5 * std::max(1.0, std::fabs(t))) { when.push_back(t); frames.push_back((float)t); }
   if (when.size() > 1000000 || when.size() * channels.size() > (size_t)1 << 26) throw bad(text("animation has %lu keys on %lu channels: too many", (unsigned long)when.size(), (unsigned long)channels.size()));
   out->name = keep(a.name.empty() ? text("animation %lu", (unsigned long)index) : a.name);
   out->nodes = m.nodes.size();
   out->names = (char **)calloc(out->nodes + 1, sizeof *out->names);
   out->track = (ex__track *)calloc(channels.size(), sizeof *out->track);
   if (!out->names || !out->track) throw std::bad_alloc();
   for (size_t i = 0; i < out->nodes; i++) out->names[i] = keep(all.name[i]);
   out->parents = keep(all.parent);
   out->rest = keep(all.rest);
   out->world = keep(std::vector<float>(all.world.begin(), all.world.end()));
   out->times = keep(frames);
   out->frames = frames.size();
   for (const channel &c : channels) {
      unsigned width = c.kind == 1 ? 4 : 3;
      std::vector<float> v(when.size() * width);
      for (size_t f = 0; f < when.size(); f++) sample(c, when[f], width, &v[f * width]);
      ex__track t;
      t.node = c.node;
      t.kind = c.kind;
      t.values = keep(v);
      out->track[out->tracks++] = t;
   }
}

} // namespace

extern "C" ex_scene *ex__gltf_scene(const char *path, char *error)
{
   ex_scene *s = (ex_scene *)calloc(1, sizeof *s);
   try {
      if (!s) throw std::bad_alloc();
      fill_scene(s, path);
      return s;
   } catch (const std::bad_alloc &) { report(error, path, "out of memory"); }
   catch (const std::exception &e) { report(error, path, e.what()); }
   ex_scene_free(s);
   return nullptr;
}
extern "C" ex_mesh *ex__gltf_mesh(const char *path, char *error)
{
   ex_mesh *m = (ex_mesh *)calloc(1, sizeof *m);
   try {
      if (!m) throw std::bad_alloc();
      fill_mesh(m, path);
      return m;
   } catch (const std::bad_alloc &) { report(error, path, "out of memory"); }
   catch (const std::exception &e) { report(error, path, e.what()); }
   ex_mesh_free(m);
   return nullptr;
}
extern "C" ex__clip *ex__gltf_clip(const char *path, const char *which, char *error)
{
   ex__clip *c = (ex__clip *)calloc(1, sizeof *c);
   try {
      if (!c) throw std::bad_alloc();
      fill_clip(c, path, which);
      return c;
   } catch (const std::bad_alloc &) { report(error, path, "out of memory"); }
   catch (const std::exception &e) { report(error, path, e.what()); }
   ex__clip_free(c);
   return nullptr;
}
#endif
