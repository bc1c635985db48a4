/*  scene.c - see scene.h: what does not need a glTF reader */
#include "scene.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static char *copy_text(const char *s, size_t n)
{
   char *r = (char *)malloc(n + 1);
   if (r) { memcpy(r, s, n); r[n] = 0; }
   return r;
}
static int ends_with(const char *s, const char *end)
{
   size_t n = strlen(s), m = strlen(end), i;
   if (n < m) return 0;
   for (i = 0; i < m; i++) {
      char c = s[n - m + i];
      if (c >= 'A' && c <= 'Z') c = (char)(c + 32);
      if (c != end[i]) return 0;
   }
   return 1;
}
const char *ex_short_name(const char *name)
{
   const char *p, *r = name;
   for (p = name; *p; p++) if ((*p == ':' || *p == '|') && p[1]) r = p + 1;
   return r;
}

/* ------------------------------------------------- 3x4 matrices, row-major, acting on columns (x,y,z,1) */
static const double identity[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
void ex__matrix(const float *trs, double *m)
{
   double x = (double)trs[3], y = (double)trs[4], z = (double)trs[5], w = (double)trs[6], n = x * x + y * y + z * z + w * w, s = n > 0 ? 2 / n : 0;
   double r[9];
   int i, k;
   r[0] = 1 - s * (y * y + z * z); r[1] = s * (x * y - w * z); r[2] = s * (x * z + w * y);
   r[3] = s * (x * y + w * z); r[4] = 1 - s * (x * x + z * z); r[5] = s * (y * z - w * x);
   r[6] = s * (x * z - w * y); r[7] = s * (y * z + w * x); r[8] = 1 - s * (x * x + y * y);
   for (i = 0; i < 3; i++) {
      for (k = 0; k < 3; k++) m[4 * i + k] = r[3 * i + k] * (double)trs[7 + k];
      m[4 * i + 3] = (double)trs[i];
   }
}
void ex__multiply(const double *a, const double *b, double *out)
{
   double r[12];
   int i, k;
   for (i = 0; i < 3; i++) for (k = 0; k < 4; k++)
      r[4 * i + k] = a[4 * i] * b[k] + a[4 * i + 1] * b[4 + k] + a[4 * i + 2] * b[8 + k] + (k == 3 ? a[4 * i + 3] : 0);
   memcpy(out, r, sizeof r);
}
int ex__invert(const double *m, double *out)
{
   double c[3][3], d, big = 0, move[3];
   int i, k;
   for (i = 0; i < 3; i++) move[i] = m[4 * i + 3]; /* out may be m */
   for (i = 0; i < 3; i++) for (k = 0; k < 3; k++) {
      int a = (i + 1) % 3, b = (i + 2) % 3, e = (k + 1) % 3, f = (k + 2) % 3;
      c[k][i] = m[4 * a + e] * m[4 * b + f] - m[4 * a + f] * m[4 * b + e];
      if (fabs(m[4 * i + k]) > big) big = fabs(m[4 * i + k]);
   }
   d = m[0] * c[0][0] + m[1] * c[1][0] + m[2] * c[2][0];
   if (!(fabs(d) > 1e-12 * big * big * big)) return 0;
   for (i = 0; i < 3; i++) {
      double t[4];
      for (k = 0; k < 3; k++) t[k] = c[i][k] / d;
      t[3] = -(t[0] * move[0] + t[1] * move[1] + t[2] * move[2]);
      memcpy(out + 4 * i, t, sizeof t);
   }
   return 1;
}
static void widen(const float *a, double *m) { int i; for (i = 0; i < 12; i++) m[i] = (double)a[i]; }
static int finite_all(const float *v, size_t n, size_t *where)
{
   size_t i;
   for (i = 0; i < n; i++) { /* by bits: holds under -ffast-math too */
      uint32_t u;
      memcpy(&u, v + i, 4);
      if ((u >> 23 & 255) == 255) { *where = i; return 0; }
   }
   return 1;
}

/* ------------------------------------------------- normals, skinning */
void ex_normals(size_t vertices, const float *p, size_t triangles, const uint32_t *triangle, float *out)
{
   size_t t, i;
   memset(out, 0, vertices * 3 * sizeof *out);
   for (t = 0; t < triangles; t++) {
      const uint32_t *q = triangle + 3 * t;
      const float *a = p + 3 * (size_t)q[0], *b = p + 3 * (size_t)q[1], *c = p + 3 * (size_t)q[2];
      float e[3], f[3], n[3];
      for (i = 0; i < 3; i++) { e[i] = b[i] - a[i]; f[i] = c[i] - a[i]; }
      n[0] = e[1] * f[2] - e[2] * f[1]; n[1] = e[2] * f[0] - e[0] * f[2]; n[2] = e[0] * f[1] - e[1] * f[0];
      for (i = 0; i < 9; i++) out[3 * (size_t)q[i / 3] + i % 3] += n[i % 3];
   }
   for (i = 0; i < vertices; i++) {
      float *n = out + 3 * i;
      double l = sqrt((double)n[0] * (double)n[0] + (double)n[1] * (double)n[1] + (double)n[2] * (double)n[2]);
      for (t = 0; t < 3; t++) n[t] = l > 0 ? (float)((double)n[t] / l) : (t == 1 ? 1.0f : 0.0f); /* a lone vertex: up */
   }
}
void ex_skin(const ex_scene *s, const float *palette, float *out)
{
   size_t i, k, c;
   for (i = 0; i < s->vertices; i++) {
      const float *x = s->positions + 3 * i;
      float m[12], sum = 0;
      memset(m, 0, sizeof m);
      for (k = 0; k < s->influences; k++) {
         float w = s->skin_weights[i * s->influences + k];
         const float *q = palette + 12 * (size_t)s->skin_joints[i * s->influences + k];
         if (!(w > 0)) continue;
         sum += w;
         for (c = 0; c < 12; c++) m[c] += w * q[c];
      }
      if (!(sum > 0)) { memcpy(m, palette, sizeof m); sum = 1; }
      for (c = 0; c < 3; c++) out[3 * i + c] = (m[4 * c] * x[0] + m[4 * c + 1] * x[1] + m[4 * c + 2] * x[2] + m[4 * c + 3]) / sum;
   }
}

/* ------------------------------------------------- characters */
void ex_scene_free(ex_scene *s)
{
   size_t i;
   if (!s) return;
   for (i = 0; s->names && i < s->joints; i++) free(s->names[i]);
   for (i = 0; s->range && i < s->ranges; i++) free(s->range[i].name);
   free(s->path); free(s->positions); free(s->normals); free(s->triangle); free(s->skin_joints); free(s->skin_weights);
   free(s->names); free(s->parents); free(s->rest); free(s->above); free(s->inverse_bind); free(s->joint_rest); free(s->range);
   free(s);
}
static int permute(void *list, size_t size, const size_t *from, size_t n)
{
   char *copy = (char *)malloc(size * n + 1);
   size_t i;
   if (!copy) return 0;
   memcpy(copy, list, size * n);
   for (i = 0; i < n; i++) memcpy((char *)list + size * i, copy + size * from[i], size);
   free(copy);
   return 1;
}
/* parents before children; the file's order is kept where it already is so */
static int order_joints(ex_scene *s, char *error)
{
   size_t n = s->joints, done = 0, i, *from = (size_t *)malloc((n + 1) * sizeof *from), *to = (size_t *)malloc((n + 1) * sizeof *to);
   int moved = 0, ok = 0;
   if (!from || !to) { ex_fail(error, s->path, "out of memory"); goto end; }
   for (i = 0; i < n; i++) to[i] = SIZE_MAX;
   while (done < n) {
      size_t before = done;
      for (i = 0; i < n; i++)
         if (to[i] == SIZE_MAX && (s->parents[i] < 0 || to[s->parents[i]] != SIZE_MAX)) { moved |= i != done; to[i] = done; from[done++] = i; }
      if (done == before) { ex_fail(error, s->path, "the joints' parents form a circle"); goto end; }
   }
   if (moved) {
      if (!permute(s->names, sizeof *s->names, from, n) || !permute(s->parents, sizeof *s->parents, from, n) || !permute(s->rest, 10 * sizeof *s->rest, from, n) ||
          !permute(s->above, 12 * sizeof *s->above, from, n) || !permute(s->inverse_bind, 12 * sizeof *s->inverse_bind, from, n)) { ex_fail(error, s->path, "out of memory"); goto end; }
      for (i = 0; i < n; i++) if (s->parents[i] >= 0) s->parents[i] = (int32_t)to[s->parents[i]];
      for (i = 0; i < s->vertices * s->influences; i++) s->skin_joints[i] = (uint32_t)to[s->skin_joints[i]];
   }
   ok = 1;
end:
   free(from);
   free(to);
   return ok;
}
/* checks all that any reader filled in, orders the joints, adds joint_rest and normals */
static int finish(ex_scene *s, char *error)
{
   size_t i, k, w = 0;
   if (!s->vertices) return ex_fail(error, s->path, "has no vertices");
   if (!s->triangles) return ex_fail(error, s->path, "has no triangles");
   if (!s->joints) return ex_fail(error, s->path, "has no joints");
   if (s->vertices > UINT32_MAX || s->joints > INT32_MAX) return ex_fail(error, s->path, "has too many vertices or joints");
   if (!finite_all(s->positions, 3 * s->vertices, &w)) return ex_fail(error, s->path, "position of vertex %lu is not finite", (unsigned long)(w / 3));
   for (i = 0; i < 3 * s->vertices; i++) if (!(fabsf(s->positions[i]) < 1e9f)) return ex_fail(error, s->path, "position of vertex %lu is %g", (unsigned long)(i / 3), (double)s->positions[i]);
   for (i = 0; i < 3 * s->triangles; i++)
      if (s->triangle[i] >= s->vertices) return ex_fail(error, s->path, "triangle %lu names vertex %lu of %lu", (unsigned long)(i / 3), (unsigned long)s->triangle[i], (unsigned long)s->vertices);
   if (!finite_all(s->skin_weights, s->vertices * s->influences, &w)) return ex_fail(error, s->path, "skin weight of vertex %lu is not finite", (unsigned long)(w / s->influences));
   for (i = 0; i < s->vertices * s->influences; i++) {
      if (s->skin_weights[i] == 0) s->skin_joints[i] = 0; /* exporters leave anything here */
      if (s->skin_joints[i] >= s->joints) return ex_fail(error, s->path, "vertex %lu is bound to joint %lu of %lu", (unsigned long)(i / s->influences), (unsigned long)s->skin_joints[i], (unsigned long)s->joints);
   }
   for (i = 0; i < s->joints; i++) {
      double m[12];
      if (s->parents[i] < -1 || s->parents[i] >= (int32_t)s->joints) return ex_fail(error, s->path, "joint %lu has parent %ld of %lu", (unsigned long)i, (long)s->parents[i], (unsigned long)s->joints);
      if (!finite_all(s->rest + 10 * i, 10, &w) || !finite_all(s->above + 12 * i, 12, &w)) return ex_fail(error, s->path, "transform of joint %.60s is not finite", s->names[i]);
      if (!finite_all(s->inverse_bind + 12 * i, 12, &w)) return ex_fail(error, s->path, "inverse bind matrix of joint %.60s is not finite", s->names[i]);
      widen(s->inverse_bind + 12 * i, m);
      if (!ex__invert(m, m)) return ex_fail(error, s->path, "inverse bind matrix of joint %.60s is singular", s->names[i]);
   }
   if (!order_joints(s, error)) return 0;
   s->joint_rest = (float *)malloc(3 * s->joints * sizeof *s->joint_rest);
   if (!s->joint_rest) return ex_fail(error, s->path, "out of memory");
   for (i = 0; i < s->joints; i++) {
      double m[12];
      widen(s->inverse_bind + 12 * i, m);
      ex__invert(m, m);
      for (k = 0; k < 3; k++) s->joint_rest[3 * i + k] = (float)m[4 * k + 3];
   }
   if (s->normals && !finite_all(s->normals, 3 * s->vertices, &w)) { free(s->normals); s->normals = NULL; }
   if (!s->normals) {
      s->normals = (float *)malloc(3 * s->vertices * sizeof *s->normals);
      if (!s->normals) return ex_fail(error, s->path, "out of memory");
      ex_normals(s->vertices, s->positions, s->triangles, s->triangle, s->normals);
   }
   return 1;
}

/* names of a comma-separated list; quotes and brackets of a JSON list are tolerated */
static int split_names(ex_scene *s, const char *list, char *error)
{
   size_t n = 0;
   const char *p = list, *a;
   s->names = (char **)calloc(s->joints, sizeof *s->names);
   if (!s->names) return ex_fail(error, s->path, "out of memory");
   while (*p && n < s->joints) {
      size_t l;
      while (*p && strchr(" \t\r\n\"[],", *p)) p++;
      for (a = p; *p && !strchr(",\"]", *p); p++) {}
      l = (size_t)(p - a);
      if (!l) break;
      if (!(s->names[n++] = copy_text(a, l))) return ex_fail(error, s->path, "out of memory");
   }
   while (*p && strchr(" \t\r\n\"],", *p)) p++;
   if (n != s->joints || *p) return ex_fail(error, s->path, "metadata joint_names does not list exactly %lu names", (unsigned long)s->joints);
   return 1;
}
static float *take_f32(const ex_tensors *f, const char *name, size_t rank, size_t a, size_t b, size_t c, size_t *first, char *error)
{
   size_t side[3];
   const ex_tensor *t;
   float *r;
   side[0] = a; side[1] = b; side[2] = c;
   if (!(t = ex_tensors_get(f, name, rank, side, error))) return NULL;
   if (first) *first = t->shape[0];
   r = (float *)malloc(t->count * sizeof *r + 1);
   if (!r) { ex_fail(error, ex_tensors_path(f), "out of memory"); return NULL; }
   ex_tensor_f32(t, r);
   return r;
}
static uint32_t *take_u32(const ex_tensors *f, const char *name, size_t a, size_t b, size_t *first, size_t *second, char *error)
{
   size_t side[2];
   const ex_tensor *t;
   uint32_t *r;
   side[0] = a; side[1] = b;
   if (!(t = ex_tensors_get(f, name, 2, side, error))) return NULL;
   *first = t->shape[0];
   *second = t->shape[1];
   r = (uint32_t *)malloc(t->count * sizeof *r + 1);
   if (!r) { ex_fail(error, ex_tensors_path(f), "out of memory"); return NULL; }
   if (!ex_tensor_u32(f, t, r, error)) { free(r); return NULL; }
   return r;
}
static ex_scene *tensors_scene(const char *path, char *error)
{
   ex_scene *s = (ex_scene *)calloc(1, sizeof *s);
   ex_tensors *f = ex_tensors_open(path, error);
   const ex_tensor *t;
   const char *names;
   float *parents = NULL, *joint_rest = NULL;
   size_t i, k, n, three, side;
   int ok = 0;
   if (!f) goto end;
   if (!s || !(s->path = copy_text(path, strlen(path)))) { ex_fail(error, path, "out of memory"); goto end; }
   if (!ex_tensors_find(f, "positions")) { ex_fail(error, path, "is no character: it has no tensor positions"); goto end; }
   if (!(s->positions = take_f32(f, "positions", 2, 0, 3, 0, &s->vertices, error))) goto end;
   if (!(s->triangle = take_u32(f, "triangles", 0, 3, &s->triangles, &three, error))) goto end;
   if (!(s->skin_joints = take_u32(f, "skin_joints", s->vertices, 0, &n, &s->influences, error))) goto end;
   if (!(s->skin_weights = take_f32(f, "skin_weights", 2, s->vertices, s->influences, 0, NULL, error))) goto end;
   if (!(joint_rest = take_f32(f, "joint_rest", 2, 0, 3, 0, &s->joints, error))) goto end;
   if (!s->joints || !s->influences) { ex_fail(error, path, "has no joints"); goto end; }
   side = s->joints;
   if (!(parents = take_f32(f, "parents", 1, side, 0, 0, NULL, error))) goto end;
   if (!finite_all(joint_rest, 3 * s->joints, &n)) { ex_fail(error, path, "joint_rest is not finite"); goto end; }
   s->parents = (int32_t *)malloc(s->joints * sizeof *s->parents);
   s->above = (float *)malloc(12 * s->joints * sizeof *s->above);
   s->rest = (float *)calloc(10 * s->joints, sizeof *s->rest);
   s->inverse_bind = (float *)malloc(12 * s->joints * sizeof *s->inverse_bind);
   s->range = (ex_range *)calloc(1, sizeof *s->range);
   if (!s->parents || !s->above || !s->rest || !s->inverse_bind || !s->range) { ex_fail(error, path, "out of memory"); goto end; }
   s->ranges = 1;
   s->range[0].vertices = s->vertices;
   s->range[0].triangles = s->triangles;
   if (!(s->range[0].name = copy_text("character", 9))) { ex_fail(error, path, "out of memory"); goto end; }
   for (i = 0; i < s->joints; i++) {
      if (!(parents[i] >= -1 && parents[i] < (float)s->joints)) { ex_fail(error, path, "joint %lu has parent %g of %lu", (unsigned long)i, (double)parents[i], (unsigned long)s->joints); goto end; }
      s->parents[i] = (int32_t)parents[i];
      for (k = 0; k < 12; k++) {
         s->above[12 * i + k] = (float)identity[k];
         s->inverse_bind[12 * i + k] = k % 4 == 3 ? -joint_rest[3 * i + k / 4] : (float)identity[k];
      }
      for (k = 0; k < 3; k++) {
         s->rest[10 * i + k] = joint_rest[3 * i + k] - (parents[i] >= 0 ? joint_rest[3 * (size_t)parents[i] + k] : 0);
         s->rest[10 * i + 7 + k] = 1;
      }
      s->rest[10 * i + 6] = 1;
   }
   if (ex_tensors_find(f, "inverse_bind")) {
      free(s->inverse_bind);
      if (!(s->inverse_bind = take_f32(f, "inverse_bind", 3, side, 3, 4, NULL, error))) goto end;
   }
   if (ex_tensors_find(f, "joint_local")) {
      free(s->rest);
      if (!(s->rest = take_f32(f, "joint_local", 2, side, 10, 0, NULL, error))) goto end;
   }
   if (ex_tensors_find(f, "joint_above")) {
      free(s->above);
      if (!(s->above = take_f32(f, "joint_above", 3, side, 3, 4, NULL, error))) goto end;
   }
   if ((t = ex_tensors_find(f, "normals")) != NULL && !(s->normals = take_f32(f, "normals", 2, s->vertices, 3, 0, NULL, error))) goto end;
   names = ex_tensors_meta(f, "joint_names");
   if (!names) { ex_fail(error, path, "has no metadata joint_names"); goto end; }
   ok = split_names(s, names, error) && finish(s, error);
end:
   free(parents);
   free(joint_rest);
   ex_tensors_close(f);
   if (!ok) { ex_scene_free(s); s = NULL; }
   return s;
}
ex_scene *ex_scene_load(const char *path, char *error)
{
   ex_scene *s;
   if (ends_with(path, ".safetensors")) return tensors_scene(path, error);
   if (!ends_with(path, ".glb") && !ends_with(path, ".gltf")) { ex_fail(error, path, "is neither .glb, .gltf nor .safetensors"); return NULL; }
   s = ex__gltf_scene(path, error);
   if (s && !finish(s, error)) { ex_scene_free(s); s = NULL; }
   return s;
}
int ex_scene_save(const ex_scene *s, const char *path, char *error)
{
   size_t n = 1, i, id[10], shape[3];
   char *names, *o;
   ex_writer *w = ex_writer_open(path, error);
   if (!w) return 0;
   for (i = 0; i < s->joints; i++) n += strlen(s->names[i]) + 1;
   names = o = (char *)malloc(n);
   for (i = 0; names && i < s->joints; i++) {
      const char *p;
      if (i) *o++ = ',';
      for (p = s->names[i]; *p; p++) *o++ = strchr(",\"[]", *p) ? '_' : *p;
   }
   if (names) *o = 0;
   ex_writer_meta(w, "joint_names", names ? names : "");
   ex_writer_meta(w, "format", "character");
   free(names);
   shape[0] = s->vertices; shape[1] = 3;
   id[0] = ex_writer_tensor(w, "positions", EX_F32, 2, shape);
   id[1] = ex_writer_tensor(w, "normals", EX_F32, 2, shape);
   shape[0] = s->triangles;
   id[2] = ex_writer_tensor(w, "triangles", EX_I32, 2, shape);
   shape[0] = s->vertices; shape[1] = s->influences;
   id[3] = ex_writer_tensor(w, "skin_joints", EX_I32, 2, shape);
   id[4] = ex_writer_tensor(w, "skin_weights", EX_F32, 2, shape);
   shape[0] = s->joints; shape[1] = 3; shape[2] = 4;
   id[5] = ex_writer_tensor(w, "joint_rest", EX_F32, 2, shape);
   id[6] = ex_writer_tensor(w, "parents", EX_I32, 1, shape);
   id[7] = ex_writer_tensor(w, "inverse_bind", EX_F32, 3, shape);
   id[8] = ex_writer_tensor(w, "joint_above", EX_F32, 3, shape);
   shape[1] = 10;
   id[9] = ex_writer_tensor(w, "joint_local", EX_F32, 2, shape);
   ex_writer_put(w, id[0], 0, s->positions, 3 * s->vertices);
   ex_writer_put(w, id[1], 0, s->normals, 3 * s->vertices);
   ex_writer_put(w, id[2], 0, s->triangle, 3 * s->triangles);
   ex_writer_put(w, id[3], 0, s->skin_joints, s->vertices * s->influences);
   ex_writer_put(w, id[4], 0, s->skin_weights, s->vertices * s->influences);
   ex_writer_put(w, id[5], 0, s->joint_rest, 3 * s->joints);
   ex_writer_put(w, id[6], 0, s->parents, s->joints);
   ex_writer_put(w, id[7], 0, s->inverse_bind, 12 * s->joints);
   ex_writer_put(w, id[8], 0, s->above, 12 * s->joints);
   ex_writer_put(w, id[9], 0, s->rest, 10 * s->joints);
   return ex_writer_close(w, error);
}

/* ------------------------------------------------- poses */
void ex_pose_local(const ex_scene *s, const float *local, float *palette)
{
   size_t j, k;
   double *world = (double *)malloc(12 * s->joints * sizeof *world);
   if (!local) local = s->rest;
   for (j = 0; j < s->joints; j++) { /* palette_j = world_parent above_j local_j inverse_bind_j */
      double m[12], bind[12], p[12];
      const double *up = s->parents[j] < 0 ? identity : world + 12 * (size_t)s->parents[j];
      if (!world) { for (k = 0; k < 12; k++) palette[12 * j + k] = (float)identity[k]; continue; }
      widen(s->above + 12 * j, m);
      ex__multiply(up, m, world + 12 * j);
      ex__matrix(local + 10 * j, m);
      ex__multiply(world + 12 * j, m, world + 12 * j);
      widen(s->inverse_bind + 12 * j, bind);
      ex__multiply(world + 12 * j, bind, p);
      for (k = 0; k < 12; k++) palette[12 * j + k] = (float)p[k];
   }
   free(world);
}
void ex_pose(const ex_scene *s, const ex_motion *m, size_t frame, float *palette)
{
   if (m->palettes) memcpy(palette, m->palettes + 12 * frame * s->joints, 12 * s->joints * sizeof *palette);
   else ex_pose_local(s, m->local + 10 * frame * s->joints, palette);
}

/* ------------------------------------------------- motions */
void ex_motion_free(ex_motion *m)
{
   if (!m) return;
   free(m->name); free(m->times); free(m->local); free(m->palettes);
   free(m);
}
void ex__clip_free(ex__clip *c)
{
   size_t i;
   if (!c) return;
   for (i = 0; c->names && i < c->nodes; i++) free(c->names[i]);
   for (i = 0; c->track && i < c->tracks; i++) free(c->track[i].values);
   free(c->name); free(c->names); free(c->parents); free(c->rest); free(c->world); free(c->times); free(c->track);
   free(c);
}
/* world matrices (S,12) of the rest pose */
static double *rest_world(const ex_scene *s)
{
   double *world = (double *)malloc(12 * s->joints * sizeof *world), m[12];
   size_t j;
   for (j = 0; world && j < s->joints; j++) {
      widen(s->above + 12 * j, m);
      ex__multiply(s->parents[j] < 0 ? identity : world + 12 * (size_t)s->parents[j], m, world + 12 * j);
      ex__matrix(s->rest + 10 * j, m);
      ex__multiply(world + 12 * j, m, world + 12 * j);
   }
   return world;
}
/*  the joint whose height measures a skeleton: the first one clearly off the ground ("hips"), for a root
    joint may lie between the feet */
static size_t hip_joint(const ex_scene *s, const double *world, const int32_t *node)
{
   double lo = 1e30, hi = -1e30;
   size_t j;
   for (j = 0; j < s->joints; j++) { double y = world[12 * j + 7]; lo = y < lo ? y : lo; hi = y > hi ? y : hi; }
   for (j = 0; j < s->joints; j++) if (node[j] >= 0 && world[12 * j + 7] > 0.1 * (hi - lo)) return j;
   return SIZE_MAX;
}
/* the rotation of an orthogonal matrix (its first three columns) as x y z w */
static void quaternion(const double *m, double *q)
{
   double t = m[0] + m[5] + m[10], l;
   if (t > 0) { q[3] = 1 + t; q[0] = m[9] - m[6]; q[1] = m[2] - m[8]; q[2] = m[4] - m[1]; }
   else {
      int i = m[0] > m[5] ? (m[0] > m[10] ? 0 : 2) : (m[5] > m[10] ? 1 : 2), j = (i + 1) % 3, k = (i + 2) % 3;
      q[i] = 1 + m[5 * i] - m[5 * j] - m[5 * k];
      q[j] = m[4 * j + i] + m[4 * i + j];
      q[k] = m[4 * k + i] + m[4 * i + k];
      q[3] = m[4 * k + j] - m[4 * j + k];
   }
   l = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
   if (l > 0) { q[0] /= l; q[1] /= l; q[2] /= l; q[3] /= l; }
   else q[3] = 1;
}
static ex_motion *clip_motion(const char *path, const ex__clip *c, const ex_scene *s, char *error)
{
   ex_motion *m = (ex_motion *)calloc(1, sizeof *m);
   double *world = rest_world(s), ratio = 1;
   int32_t *node = (int32_t *)malloc(s->joints * sizeof *node);
   unsigned char *moved = (unsigned char *)calloc(c->nodes + 1, 1), *used = (unsigned char *)calloc(s->joints + 1, 1);
   size_t j, i, f, k, hip;
   int ok = 0, exact;
   if (!m || !world || !node || !moved || !used) goto memory;
   for (i = 0; i < c->tracks; i++) moved[c->track[i].node] = 1;
   for (j = 0; j < s->joints; j++) { /* the same full name and moved, before the same short name, before one that rests */
      int best = 0;
      node[j] = -1;
      for (i = 0; i < c->nodes; i++) {
         int rank = !strcmp(c->names[i], s->names[j]) ? 2 : !strcmp(ex_short_name(c->names[i]), ex_short_name(s->names[j])) ? 1 : 0;
         if (rank) rank += 2 * moved[i];
         if (rank > best) { best = rank; node[j] = (int32_t)i; }
      }
      if (node[j] >= 0 && moved[node[j]]) m->joints_matched++;
   }
   if (!m->joints_matched) {
      for (i = 0; i + 1 < c->nodes && !moved[i]; i++) {}
      ex_fail(error, path, "moves no joint of %.60s (it moves \"%.30s\", the character has \"%.30s\")", s->path, c->names[i], s->names[0]);
      goto end;
   }
   hip = hip_joint(s, world, node);
   if (hip != SIZE_MAX) {
      double there = (double)c->world[12 * (size_t)node[hip] + 7];
      if (there > 0) ratio = world[12 * hip + 7] / there;
      if (!(ratio > 1e-3 && ratio < 1e3)) ratio = 1;
   }
   if (c->frames > SIZE_MAX / 64 / s->joints) goto memory;
   m->frames = c->frames;
   m->joints = s->joints;
   m->name = copy_text(c->name, strlen(c->name));
   m->times = (float *)malloc(c->frames * sizeof *m->times);
   m->local = (float *)malloc(10 * c->frames * s->joints * sizeof *m->local);
   if (!m->name || !m->times || !m->local) goto memory;
   memcpy(m->times, c->times, c->frames * sizeof *m->times);
   m->fps = c->frames > 1 && c->times[c->frames - 1] > c->times[0] ? (float)(c->frames - 1) / (c->times[c->frames - 1] - c->times[0]) : 30.0f;
   for (f = 0; f < c->frames; f++) memcpy(m->local + 10 * f * s->joints, s->rest, 10 * s->joints * sizeof *m->local);
   for (i = 0; i < c->tracks; i++) for (j = 0; j < s->joints; j++) {
      const ex__track *t = &c->track[i];
      const float *there = c->rest + 10 * t->node, *here = s->rest + 10 * j;
      double turn[12], up[12], q[4] = {0, 0, 0, 1};
      if (node[j] != (int32_t)t->node) continue;
      exact = 1;
      memcpy(turn, identity, sizeof turn);
      if (s->parents[j] < 0 && t->kind < 2) { /* a root moves in the world: above it the two files may turn differently */
         double a[12], b[12];
         widen(s->above + 12 * j, a);
         memcpy(b, identity, sizeof b);
         if (c->parents[t->node] >= 0) widen(c->world + 12 * (size_t)c->parents[t->node], b);
         for (k = 0; k < 12; k++) if (k % 4 < 3 && fabs(a[k] - b[k]) > 1e-6) exact = 0;
         if (!exact && ex__invert(a, up)) { ex__multiply(up, b, turn); quaternion(turn, q); }
      }
      for (f = 0; f < c->frames; f++) {
         float *out = m->local + 10 * (f * s->joints + j);
         if (t->kind == 0) {
            const float *v = t->values + 3 * f;
            double d[3];
            for (k = 0; k < 3; k++) d[k] = ((double)v[k] - (double)there[k]) * ratio;
            for (k = 0; k < 3; k++) out[k] = (float)((double)here[k] + turn[4 * k] * d[0] + turn[4 * k + 1] * d[1] + turn[4 * k + 2] * d[2]);
         } else if (t->kind == 1) {
            const float *v = t->values + 4 * f;
            double x = (double)v[0], y = (double)v[1], z = (double)v[2], w = (double)v[3];
            if (exact) { memcpy(out + 3, v, 4 * sizeof *out); continue; }
            out[3] = (float)(q[3] * x + q[0] * w + q[1] * z - q[2] * y);
            out[4] = (float)(q[3] * y - q[0] * z + q[1] * w + q[2] * x);
            out[5] = (float)(q[3] * z + q[0] * y - q[1] * x + q[2] * w);
            out[6] = (float)(q[3] * w - q[0] * x - q[1] * y - q[2] * z);
         }
         else memcpy(out + 7, t->values + 3 * f, 3 * sizeof *out);
      }
   }
   ok = 1;
   goto end;
memory:
   ex_fail(error, path, "out of memory");
end:
   free(world); free(node); free(moved); free(used);
   if (!ok) { ex_motion_free(m); m = NULL; }
   return m;
}
static ex_motion *tensors_motion(const char *path, const ex_scene *s, char *error)
{
   ex_motion *m = (ex_motion *)calloc(1, sizeof *m);
   ex_tensors *f = ex_tensors_open(path, error);
   const ex_tensor *t;
   const char *fps;
   size_t i, bad, side[4];
   int ok = 0;
   if (!f) goto end;
   if (!m) { ex_fail(error, path, "out of memory"); goto end; }
   if (!ex_tensors_find(f, "palettes")) { ex_fail(error, path, "is no motion: it has no tensor palettes"); goto end; }
   side[0] = 0; side[1] = s->joints; side[2] = 3; side[3] = 4;
   if (!(t = ex_tensors_get(f, "palettes", 4, side, error))) goto end;
   if (!t->shape[0]) { ex_fail(error, path, "has no frames"); goto end; }
   m->frames = t->shape[0];
   m->joints = m->joints_matched = s->joints;
   m->palettes = (float *)malloc(t->count * sizeof *m->palettes);
   m->times = (float *)malloc(m->frames * sizeof *m->times);
   m->name = copy_text("palettes", 8);
   if (!m->palettes || !m->times || !m->name) { ex_fail(error, path, "out of memory"); goto end; }
   ex_tensor_f32(t, m->palettes);
   if (!finite_all(m->palettes, t->count, &bad)) { ex_fail(error, path, "palette of frame %lu is not finite", (unsigned long)(bad / 12 / s->joints)); goto end; }
   fps = ex_tensors_meta(f, "fps");
   m->fps = fps ? (float)atof(fps) : 30.0f;
   if (!(m->fps > 0 && m->fps < 1e6f)) m->fps = 30;
   for (i = 0; i < m->frames; i++) m->times[i] = (float)i / m->fps;
   ok = 1;
end:
   ex_tensors_close(f);
   if (!ok) { ex_motion_free(m); m = NULL; }
   return m;
}
ex_motion *ex_motion_load(const char *path, const char *which, const ex_scene *s, char *error)
{
   ex__clip *c;
   ex_motion *m;
   if (ends_with(path, ".safetensors")) return tensors_motion(path, s, error);
   if (!ends_with(path, ".glb") && !ends_with(path, ".gltf")) { ex_fail(error, path, "is neither .glb, .gltf nor .safetensors"); return NULL; }
   if (!(c = ex__gltf_clip(path, which, error))) return NULL;
   m = clip_motion(path, c, s, error);
   ex__clip_free(c);
   return m;
}

#ifndef EX_TINYGLTF /* scene_gltf.cc is then empty */
ex_scene *ex__gltf_scene(const char *path, char *error)
{
   ex_fail(error, path, "reading glTF needs tinygltf: apt-get install libtinygltf-dev");
   return NULL;
}
ex__clip *ex__gltf_clip(const char *path, const char *which, char *error)
{
   (void)which;
   ex_fail(error, path, "reading glTF needs tinygltf: apt-get install libtinygltf-dev");
   return NULL;
}
#endif
