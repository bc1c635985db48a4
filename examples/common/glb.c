/*  glb.c - see glb.h */
#include "glb.h"
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void ex_normals(size_t vertices, const float *positions, size_t triangles, const uint32_t *triangle, float *out); /* scene.c */


/* ------------------------------------------------- the JSON chunk, growing */
typedef struct page { char *text; size_t count, room; int failed; } page;
static void add(page *p, const char *format, ...)
{
   va_list list;
   int n;
   if (p->room - p->count < 1024) {
      size_t room = 2 * p->room + 4096;
      char *t = (char *)realloc(p->text, room);
      if (!t) { p->failed = 1; return; }
      p->text = t;
      p->room = room;
   }
   va_start(list, format);
   n = vsnprintf(p->text + p->count, p->room - p->count, format, list);
   va_end(list);
   if (n < 0 || (size_t)n >= p->room - p->count) p->failed = 1;
   else p->count += (size_t)n;
}
static void add_name(page *p, const char *name) /* with its quotes */
{
   add(p, "\"");
   for (; *name; name++) if ((unsigned char)*name >= 32 && *name != '"' && *name != '\\') add(p, "%c", *name);
   add(p, "\"");
}
static void bounds(const float *v, size_t rows, const float *minus, float *lo, float *hi)
{
   size_t i, k;
   for (k = 0; k < 3; k++) { lo[k] = 3e38f; hi[k] = -3e38f; }
   for (i = 0; i < 3 * rows; i++) {
      float x = minus ? v[i] - minus[i] : v[i];
      if (x < lo[i % 3]) lo[i % 3] = x;
      if (x > hi[i % 3]) hi[i % 3] = x;
   }
}
static void add_bounds(page *p, const float *lo, const float *hi)
{
   add(p, ",\"min\":[%.9g,%.9g,%.9g],\"max\":[%.9g,%.9g,%.9g]", (double)lo[0], (double)lo[1], (double)lo[2], (double)hi[0], (double)hi[1], (double)hi[2]);
}
static const char opening[] = "{\"asset\":{\"version\":\"2.0\",\"generator\":\"deformnet examples\"},\"scene\":0,";
static const char clay[] = "\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.8,0.72,0.65,1],\"metallicFactor\":0,\"roughnessFactor\":0.7}}],";

/* ------------------------------------------------- the file: header, JSON, binary chunk */
typedef struct glb { FILE *out; size_t at; int failed; } glb;
static void put(glb *g, const void *data, size_t bytes) { if (bytes && fwrite(data, 1, bytes, g->out) != bytes) g->failed = 1; g->at += bytes; }
static void put32(glb *g, size_t v)
{
   unsigned char b[4];
   int i;
   for (i = 0; i < 4; i++) b[i] = (unsigned char)(v >> (8 * i));
   put(g, b, 4);
}
/* total: bytes of the binary chunk, a multiple of 4; they follow by put */
static int glb_begin(glb *g, const char *path, const page *p, size_t total, char *error)
{
   size_t json = (p->count + 3) & ~(size_t)3;
   memset(g, 0, sizeof *g);
   if (p->failed) return ex_fail(error, path, "out of memory");
   if (total + json > 0x7fffffff) return ex_fail(error, path, "%lu MB do not fit one GLB of 2 GB", (unsigned long)((total + json) >> 20));
   if (!(g->out = fopen(path, "wb"))) return ex_fail(error, path, "cannot be written");
   put(g, "glTF", 4); put32(g, 2); put32(g, 12 + 8 + json + 8 + total);
   put32(g, json); put(g, "JSON", 4); put(g, p->text, p->count); put(g, "   ", json - p->count);
   put32(g, total); put(g, "BIN\0", 4);
   return 1;
}
static int glb_end(glb *g, const char *path, char *error)
{
   if (fclose(g->out)) g->failed = 1;
   if (!g->failed) return 1;
   remove(path);
   return ex_fail(error, path, "cannot be written (disk full?)");
}
static void unit_normals(float *n, size_t vertices) /* glTF wants unit ones */
{
   size_t i;
   for (i = 0; i < vertices; i++) if (n[3 * i] == 0 && n[3 * i + 1] == 0 && n[3 * i + 2] == 0) n[3 * i + 1] = 1;
}

/* ------------------------------------------------- baked animation */
/*  Accessors and views, one view each except for the targets, which share one:
       0 triangles  1 positions  2 normals of frame 0  3 times  4 weights  5+2k, 6+2k offsets of frame k+1
    The offset of frame f is a plain difference, and the weights are 1 at f and 0 at every other frame. */
int ex_write_glb(const char *path, const ex_baked *b, char *error)
{
   size_t V = b->vertices, T = b->triangles, F = b->frames, M, f, i, length[7], total = 0;
   int ok = 0;
   float *normals = NULL, *row = NULL, lo[3], hi[3];
   page p;
   glb g;
   memset(&p, 0, sizeof p);
   if (!V || !T || !F) return ex_fail(error, path, "nothing to write: no vertices, triangles or frames");
   M = F - 1;
   if (V > 0x7fffffff / 24 / F) return ex_fail(error, path, "%lu frames of %lu vertices do not fit one GLB of 2 GB", (unsigned long)F, (unsigned long)V);
   if (!(row = (float *)malloc((3 * V + F) * sizeof *row)) || !(normals = (float *)malloc(6 * V * sizeof *normals))) { ex_fail(error, path, "out of memory"); goto end; }
   length[0] = 12 * T; length[1] = length[2] = 12 * V; length[3] = M ? 4 * F : 0; length[4] = 4 * F * M; length[5] = 24 * V * M;
   add(&p, "%s\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0,\"name\":", opening);
   add_name(&p, b->name ? b->name : "baked");
   add(&p, "}],%s\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":1,\"NORMAL\":2},\"indices\":0,\"material\":0", clay);
   for (f = 0; f < M; f++) add(&p, "%s{\"POSITION\":%lu,\"NORMAL\":%lu}%s", f ? "," : ",\"targets\":[", (unsigned long)(5 + 2 * f), (unsigned long)(6 + 2 * f), f + 1 == M ? "]" : "");
   add(&p, "}]");
   for (f = 0; f < M; f++) add(&p, "%s0%s", f ? "," : ",\"weights\":[", f + 1 == M ? "]" : "");
   add(&p, "}],");
   if (M) add(&p, "\"animations\":[{\"samplers\":[{\"input\":3,\"output\":4,\"interpolation\":\"LINEAR\"}],\"channels\":[{\"sampler\":0,\"target\":{\"node\":0,\"path\":\"weights\"}}]}],");
   add(&p, "\"bufferViews\":[");
   for (i = 0; i < (M ? 6u : 3u); i++) {
      add(&p, "%s{\"buffer\":0,\"byteOffset\":%lu,\"byteLength\":%lu%s%s}", i ? "," : "", (unsigned long)total, (unsigned long)length[i],
          i == 1 || i == 2 || i == 5 ? ",\"byteStride\":12" : "", i == 0 ? ",\"target\":34963" : i < 3 || i == 5 ? ",\"target\":34962" : "");
      total += length[i];
   }
   add(&p, "],\"accessors\":[{\"bufferView\":0,\"componentType\":5125,\"count\":%lu,\"type\":\"SCALAR\"}", (unsigned long)(3 * T));
   add(&p, ",{\"bufferView\":1,\"componentType\":5126,\"count\":%lu,\"type\":\"VEC3\"", (unsigned long)V);
   bounds(b->positions, V, NULL, lo, hi);
   add_bounds(&p, lo, hi);
   add(&p, "},{\"bufferView\":2,\"componentType\":5126,\"count\":%lu,\"type\":\"VEC3\"}", (unsigned long)V);
   if (M) {
      add(&p, ",{\"bufferView\":3,\"componentType\":5126,\"count\":%lu,\"type\":\"SCALAR\",\"min\":[%.9g],\"max\":[%.9g]}", (unsigned long)F, 0.0, (double)(b->times[F - 1] - b->times[0]));
      add(&p, ",{\"bufferView\":4,\"componentType\":5126,\"count\":%lu,\"type\":\"SCALAR\"}", (unsigned long)(F * M));
      for (f = 0; f < M; f++) {
         add(&p, ",{\"bufferView\":5,\"byteOffset\":%lu,\"componentType\":5126,\"count\":%lu,\"type\":\"VEC3\"", (unsigned long)(24 * V * f), (unsigned long)V);
         bounds(b->positions + 3 * V * (f + 1), V, b->positions, lo, hi);
         add_bounds(&p, lo, hi);
         add(&p, "},{\"bufferView\":5,\"byteOffset\":%lu,\"componentType\":5126,\"count\":%lu,\"type\":\"VEC3\"}", (unsigned long)(24 * V * f + 12 * V), (unsigned long)V);
      }
   }
   add(&p, "],\"buffers\":[{\"byteLength\":%lu}]}", (unsigned long)total);
   if (!glb_begin(&g, path, &p, total, error)) goto end;
   put(&g, b->triangle, length[0]);
   put(&g, b->positions, 12 * V);
   if (b->normals) memcpy(normals, b->normals, 12 * V);
   else ex_normals(V, b->positions, T, b->triangle, normals);
   unit_normals(normals, V);
   put(&g, normals, 12 * V);
   if (M) {
      for (f = 0; f < F; f++) row[f] = b->times[f] - b->times[0];
      put(&g, row, 4 * F);
      for (f = 0; f < F; f++) {
         for (i = 0; i < M; i++) row[i] = i + 1 == f ? 1.0f : 0.0f;
         put(&g, row, 4 * M);
      }
   }
   for (f = 1; f < F; f++) {
      const float *x = b->positions + 3 * V * f, *n = b->normals ? b->normals + 3 * V * f : normals + 3 * V;
      for (i = 0; i < 3 * V; i++) row[i] = x[i] - b->positions[i];
      put(&g, row, 12 * V);
      if (!b->normals) ex_normals(V, x, T, b->triangle, normals + 3 * V);
      for (i = 0; i < 3 * V; i++) row[i] = n[i] - normals[i];
      put(&g, row, 12 * V);
   }
   ok = glb_end(&g, path, error);
end:
   free(row); free(normals); free(p.text);
   return ok;
}

/* ------------------------------------------------- rigged character */
/*  The binary chunk, one view each, in this order; those without bytes are left out. In "indices" every list of moved
    vertices starts on 4 bytes. "sparse" holds the offsets of targets written sparse, "dense" those of the others. */
enum { TRIANGLES, POSITIONS, NORMALS, UVS, JOINTS, WEIGHTS, BINDS, TIMES, TURNS, TRAVEL, MORPHS, INDICES, SPARSE, DENSE, VIEWS };
typedef struct layout { size_t length[VIEWS], total; int view[VIEWS], views; } layout;

static size_t skin_accessor(const ex_rig *r) { return r->uv ? 4 : 3; }
static size_t bind_accessor(const ex_rig *r) { return skin_accessor(r) + r->influences / 2; }
static size_t target_accessor(const ex_rig *r) { return bind_accessor(r) + 1; }
static int same_list(const ex_target *a, const ex_target *b) { return a->at == b->at && a->count == b->count; }
static size_t list_bytes(const ex_rig *r, const ex_target *t) { return (t->count * (r->vertices > 65536 ? 4 : 2) + 3) & ~(size_t)3; }
/* a list costs its indices once, however many targets in a row share it */
static int is_dense(const ex_rig *r, const ex_target *t) { return 12 * t->count + list_bytes(r, t) / 2 >= 12 * r->vertices; }

static void plan(const ex_rig *r, layout *l)
{
   size_t V = r->vertices, F = r->frames, m, *n = l->length;
   int i;
   memset(l, 0, sizeof *l);
   n[TRIANGLES] = 12 * r->triangles;
   n[POSITIONS] = n[NORMALS] = 12 * V;
   n[UVS] = r->uv ? 8 * V : 0;
   n[JOINTS] = (r->joints > 256 ? 2 : 1) * V * r->influences;
   n[WEIGHTS] = 4 * V * r->influences;
   n[BINDS] = 64 * r->joints;
   if (F) n[TIMES] = 4 * F, n[TURNS] = 16 * F * r->joints, n[TRAVEL] = 12 * F, n[MORPHS] = 4 * F * r->targets;
   for (m = 0; m < r->targets; m++) {
      const ex_target *t = r->target + m;
      if (is_dense(r, t)) n[DENSE] += 12 * V;
      else {
         n[SPARSE] += 12 * t->count;
         if (m == 0 || !same_list(t, t - 1)) n[INDICES] += list_bytes(r, t);
      }
   }
   for (i = 0; i < VIEWS; i++) {
      l->view[i] = n[i] ? l->views++ : -1;
      l->total += n[i];
   }
}
static void add_views(page *p, const ex_rig *r, const layout *l)
{
   size_t at = 0;
   int i, stride;
   add(p, "\"bufferViews\":[");
   for (i = 0; i < VIEWS; i++) {
      if (!l->length[i]) continue;
      stride = i == POSITIONS || i == NORMALS || i == DENSE ? 12 : i == UVS ? 8 : i == JOINTS ? (int)r->influences * (r->joints > 256 ? 2 : 1) : i == WEIGHTS ? 4 * (int)r->influences : 0;
      add(p, "%s{\"buffer\":0,\"byteOffset\":%lu,\"byteLength\":%lu", l->view[i] ? "," : "", (unsigned long)at, (unsigned long)l->length[i]);
      if (stride) add(p, ",\"byteStride\":%d", stride);
      if (stride || i == TRIANGLES) add(p, ",\"target\":%d", i == TRIANGLES ? 34963 : 34962);
      add(p, "}");
      at += l->length[i];
   }
   add(p, "],");
}
static void add_accessor(page *p, int view, size_t offset, int component, size_t count, const char *type)
{
   add(p, "{\"bufferView\":%d", view);
   if (offset) add(p, ",\"byteOffset\":%lu", (unsigned long)offset);
   add(p, ",\"componentType\":%d,\"count\":%lu,\"type\":\"%s\"", component, (unsigned long)count, type);
}
/*  the accessors in order: triangles, positions, normals, uv?, JOINTS and WEIGHTS of each set, inverse binds, the M
    targets, and with frames: times, turns of each joint, travel, weights. Turns are joint after joint in the file. */
static void add_accessors(page *p, const ex_rig *r, const layout *l)
{
   size_t V = r->vertices, s, m, indices = 0, sparse = 0, dense = 0, list = 0;
   float lo[3], hi[3];
   int k;
   add(p, "\"accessors\":[");
   add_accessor(p, l->view[TRIANGLES], 0, 5125, 3 * r->triangles, "SCALAR");
   add(p, "},");
   add_accessor(p, l->view[POSITIONS], 0, 5126, V, "VEC3");
   bounds(r->positions, V, NULL, lo, hi);
   add_bounds(p, lo, hi);
   add(p, "},");
   add_accessor(p, l->view[NORMALS], 0, 5126, V, "VEC3");
   add(p, "},");
   if (r->uv) { add_accessor(p, l->view[UVS], 0, 5126, V, "VEC2"); add(p, "},"); }
   for (s = 0; s < r->influences; s += 4) {
      add_accessor(p, l->view[JOINTS], s * (r->joints > 256 ? 2 : 1), r->joints > 256 ? 5123 : 5121, V, "VEC4");
      add(p, "},");
      add_accessor(p, l->view[WEIGHTS], 4 * s, 5126, V, "VEC4");
      add(p, "},");
   }
   add_accessor(p, l->view[BINDS], 0, 5126, r->joints, "MAT4");
   add(p, "}");
   for (m = 0; m < r->targets; m++) {
      const ex_target *t = r->target + m;
      bounds(t->offset, t->count, NULL, lo, hi);
      if (t->count < V) for (k = 0; k < 3; k++) { lo[k] = lo[k] < 0 ? lo[k] : 0; hi[k] = hi[k] > 0 ? hi[k] : 0; }
      add(p, ",");
      if (is_dense(r, t)) {
         add_accessor(p, l->view[DENSE], dense, 5126, V, "VEC3");
         add_bounds(p, lo, hi);
         dense += 12 * V;
      } else {
         if (m == 0 || !same_list(t, t - 1)) { list = indices; indices += list_bytes(r, t); }
         add(p, "{\"componentType\":5126,\"count\":%lu,\"type\":\"VEC3\"", (unsigned long)V);
         add_bounds(p, lo, hi);
         add(p, ",\"sparse\":{\"count\":%lu,\"indices\":{\"bufferView\":%d,\"byteOffset\":%lu,\"componentType\":%d},\"values\":{\"bufferView\":%d,\"byteOffset\":%lu}}",
             (unsigned long)t->count, l->view[INDICES], (unsigned long)list, V > 65536 ? 5125 : 5123, l->view[SPARSE], (unsigned long)sparse);
         sparse += 12 * t->count;
      }
      add(p, "}");
   }
   if (r->frames) {
      add(p, ",");
      add_accessor(p, l->view[TIMES], 0, 5126, r->frames, "SCALAR");
      add(p, ",\"min\":[%.9g],\"max\":[%.9g]}", (double)r->times[0], (double)r->times[r->frames - 1]);
      for (s = 0; s < r->joints; s++) {
         add(p, ",");
         add_accessor(p, l->view[TURNS], 16 * r->frames * s, 5126, r->frames, "VEC4");
         add(p, "}");
      }
      add(p, ",");
      add_accessor(p, l->view[TRAVEL], 0, 5126, r->frames, "VEC3");
      add(p, "}");
      if (r->targets) {
         add(p, ",");
         add_accessor(p, l->view[MORPHS], 0, 5126, r->frames * r->targets, "SCALAR");
         add(p, "}");
      }
   }
   add(p, "],");
}
/* nodes: 0 the mesh, 1 + s joint s */
static void add_nodes(page *p, const ex_rig *r)
{
   size_t s, c, k, n;
   add(p, "\"scenes\":[{\"nodes\":[0");
   for (s = 0; s < r->joints; s++) if (r->parents[s] < 0) add(p, ",%lu", (unsigned long)(s + 1));
   add(p, "]}],\"nodes\":[{\"mesh\":0,\"skin\":0,\"name\":");
   add_name(p, r->name);
   add(p, "}");
   for (s = 0; s < r->joints; s++) {
      float x[3];
      for (k = 0; k < 3; k++) x[k] = r->joint_rest[3 * s + k] - (r->parents[s] < 0 ? 0 : r->joint_rest[3 * (size_t)r->parents[s] + k]);
      add(p, ",{\"name\":");
      add_name(p, r->names[s]);
      add(p, ",\"translation\":[%.9g,%.9g,%.9g]", (double)x[0], (double)x[1], (double)x[2]);
      for (c = s + 1, n = 0; c < r->joints; c++) if (r->parents[c] == (int32_t)s) add(p, "%s%lu", n++ ? "," : ",\"children\":[", (unsigned long)(c + 1));
      add(p, "%s}", n ? "]" : "");
   }
   add(p, "],\"skins\":[{\"inverseBindMatrices\":%lu,\"joints\":[", (unsigned long)bind_accessor(r));
   for (s = 0; s < r->joints; s++) add(p, "%s%lu", s ? "," : "", (unsigned long)(s + 1));
   add(p, "]}],");
}
static void add_mesh(page *p, const ex_rig *r)
{
   size_t m, k;
   add(p, "\"meshes\":[{\"name\":");
   add_name(p, r->name);
   add(p, ",\"primitives\":[{\"attributes\":{\"POSITION\":1,\"NORMAL\":2%s", r->uv ? ",\"TEXCOORD_0\":3" : "");
   for (k = 0; k < r->influences / 4; k++) {
      size_t at = skin_accessor(r) + 2 * k;
      add(p, ",\"JOINTS_%lu\":%lu,\"WEIGHTS_%lu\":%lu", (unsigned long)k, (unsigned long)at, (unsigned long)k, (unsigned long)(at + 1));
   }
   add(p, "},\"indices\":0,\"material\":0");
   for (m = 0; m < r->targets; m++) add(p, "%s{\"POSITION\":%lu}%s", m ? "," : ",\"targets\":[", (unsigned long)(target_accessor(r) + m), m + 1 == r->targets ? "]" : "");
   add(p, "}]");
   for (m = 0; m < r->targets; m++) add(p, "%s%.9g%s", m ? "," : ",\"weights\":[", (double)r->target[m].rest, m + 1 == r->targets ? "]" : "");
   for (m = 0; m < r->targets; m++) {
      add(p, "%s", m ? "," : ",\"extras\":{\"targetNames\":[");
      add_name(p, r->target[m].name);
      add(p, "%s", m + 1 == r->targets ? "]}" : "");
   }
   add(p, "}],");
}
static void add_animation(page *p, const ex_rig *r)
{
   size_t times = target_accessor(r) + r->targets, s, n = r->joints + 1 + (r->targets > 0);
   add(p, "\"animations\":[{\"name\":");
   add_name(p, r->motion ? r->motion : "motion");
   add(p, ",\"samplers\":[");
   for (s = 0; s < n; s++) add(p, "%s{\"input\":%lu,\"output\":%lu,\"interpolation\":\"LINEAR\"}", s ? "," : "", (unsigned long)times, (unsigned long)(times + 1 + s));
   add(p, "],\"channels\":[");
   for (s = 0; s < r->joints; s++) add(p, "{\"sampler\":%lu,\"target\":{\"node\":%lu,\"path\":\"rotation\"}},", (unsigned long)s, (unsigned long)(s + 1));
   add(p, "{\"sampler\":%lu,\"target\":{\"node\":1,\"path\":\"translation\"}}", (unsigned long)r->joints);
   if (r->targets) add(p, ",{\"sampler\":%lu,\"target\":{\"node\":0,\"path\":\"weights\"}}", (unsigned long)(r->joints + 1));
   add(p, "]}],");
}
static void put_skin(glb *g, const ex_rig *r)
{
   size_t i, n = r->vertices * r->influences;
   for (i = 0; i < n; i++) {
      uint32_t j = r->skin_weights[i] != 0 ? r->skin_joints[i] : 0;
      unsigned char b[2];
      b[0] = (unsigned char)j, b[1] = (unsigned char)(j >> 8);
      put(g, b, r->joints > 256 ? 2 : 1);
   }
   put(g, r->skin_weights, 4 * n);
}
static void put_targets(glb *g, const ex_rig *r, float *row)
{
   static const unsigned char zero[4] = {0, 0, 0, 0};
   size_t m, i;
   for (m = 0; m < r->targets; m++) {
      const ex_target *t = r->target + m;
      if (is_dense(r, t) || (m && same_list(t, t - 1))) continue;
      for (i = 0; i < t->count; i++) {
         unsigned char b[4];
         int k;
         for (k = 0; k < 4; k++) b[k] = (unsigned char)(t->at[i] >> (8 * k));
         put(g, b, r->vertices > 65536 ? 4 : 2);
      }
      put(g, zero, list_bytes(r, t) - t->count * (r->vertices > 65536 ? 4 : 2));
   }
   for (m = 0; m < r->targets; m++) if (!is_dense(r, r->target + m)) put(g, r->target[m].offset, 12 * r->target[m].count);
   for (m = 0; m < r->targets; m++) {
      const ex_target *t = r->target + m;
      if (!is_dense(r, t)) continue;
      memset(row, 0, 12 * r->vertices);
      for (i = 0; i < t->count; i++) memcpy(row + 3 * (size_t)t->at[i], t->offset + 3 * i, 12);
      put(g, row, 12 * r->vertices);
   }
}
int ex_write_rig(const char *path, const ex_rig *r, size_t *bytes, char *error)
{
   size_t s, f, k;
   float *row = (float *)malloc(12 * r->vertices + 1);
   layout l;
   page p;
   glb g;
   int ok = 0;
   memset(&p, 0, sizeof p);
   if (!r->vertices || !r->triangles || !r->joints || !r->influences || r->influences % 4) { ex_fail(error, path, "nothing to write: no vertices, triangles or joints"); goto end; }
   if (r->joints > 65535 || r->influences > 60) { ex_fail(error, path, "%lu joints, %lu influences a vertex: more than glTF holds", (unsigned long)r->joints, (unsigned long)r->influences); goto end; }
   if (!row) { ex_fail(error, path, "out of memory"); goto end; }
   plan(r, &l);
   l.total = (l.total + 3) & ~(size_t)3;
   add(&p, "%s", opening);
   add_nodes(&p, r);
   add(&p, "%s", clay);
   add_mesh(&p, r);
   if (r->frames) add_animation(&p, r);
   add_views(&p, r, &l);
   add_accessors(&p, r, &l);
   add(&p, "\"buffers\":[{\"byteLength\":%lu}]}", (unsigned long)l.total);
   if (!glb_begin(&g, path, &p, l.total, error)) goto end;
   put(&g, r->triangle, l.length[TRIANGLES]);
   put(&g, r->positions, l.length[POSITIONS]);
   memcpy(row, r->normals, 12 * r->vertices);
   unit_normals(row, r->vertices);
   put(&g, row, l.length[NORMALS]);
   if (r->uv) put(&g, r->uv, l.length[UVS]);
   put_skin(&g, r);
   for (s = 0; s < r->joints; s++) {
      float m[16];
      for (k = 0; k < 16; k++) m[k] = k % 5 == 0 ? 1.0f : 0.0f;
      for (k = 0; k < 3; k++) m[12 + k] = -r->joint_rest[3 * s + k]; /* column-major */
      put(&g, m, sizeof m);
   }
   if (r->frames) {
      put(&g, r->times, l.length[TIMES]);
      for (s = 0; s < r->joints; s++) for (f = 0; f < r->frames; f++) put(&g, r->turns + 4 * (f * r->joints + s), 16);
      put(&g, r->travel, l.length[TRAVEL]);
      put(&g, r->weights, l.length[MORPHS]);
   }
   put_targets(&g, r, row);
   if (bytes) *bytes = 12 + 8 + ((p.count + 3) & ~(size_t)3) + 8 + l.total;
   ok = glb_end(&g, path, error);
end:
   free(row); free(p.text);
   return ok;
}
