/*  retarget.c - see retarget.h */
#include "retarget.h"
#include "scene.h"
#include <ctype.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void ex_turns_free(ex_turns *t)
{
   if (!t) return;
   free(t->name); free(t->times); free(t->rotations); free(t->travel);
   free(t);
}
static ex_turns *turns_create(const char *name, size_t frames, size_t joints)
{
   ex_turns *t = (ex_turns *)calloc(1, sizeof *t);
   if (!t || frames > SIZE_MAX / 64 / joints) { free(t); return NULL; }
   t->frames = frames;
   t->name = (char *)malloc(strlen(name) + 1);
   t->times = (float *)calloc(frames, sizeof *t->times);
   t->rotations = (float *)calloc(9 * frames * joints, sizeof *t->rotations);
   t->travel = (float *)calloc(3 * frames, sizeof *t->travel);
   if (!t->name || !t->times || !t->rotations || !t->travel) { ex_turns_free(t); return NULL; }
   strcpy(t->name, name);
   return t;
}

/* ------------------------------------------------- rotations: 3x3, row-major */
static const double identity[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
static void multiply(const double *a, const double *b, int a_turned, int b_turned, double *out) /* turned: transposed */
{
   double r[9];
   int i, k, m;
   for (i = 0; i < 3; i++) for (k = 0; k < 3; k++)
      for (m = 0, r[3 * i + k] = 0; m < 3; m++) r[3 * i + k] += (a_turned ? a[3 * m + i] : a[3 * i + m]) * (b_turned ? b[3 * k + m] : b[3 * m + k]);
   memcpy(out, r, sizeof r);
}
static double length(const double *v) { return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }
/* the rotation of a 3x4 matrix, scale and shear removed: Gram-Schmidt on its columns */
static void rotation_of(const double *m, double *r)
{
   double x[3], y[3], l, d = 0;
   int i;
   for (i = 0; i < 3; i++) { x[i] = m[4 * i]; y[i] = m[4 * i + 1]; }
   memcpy(r, identity, sizeof identity);
   if (!((l = length(x)) > 1e-12)) return;
   for (i = 0; i < 3; i++) { x[i] /= l; d += x[i] * y[i]; }
   for (i = 0; i < 3; i++) y[i] -= d * x[i];
   if (!((l = length(y)) > 1e-12)) return;
   for (i = 0; i < 3; i++) y[i] /= l;
   for (i = 0; i < 3; i++) {
      r[3 * i] = x[i];
      r[3 * i + 1] = y[i];
      r[3 * i + 2] = x[(i + 1) % 3] * y[(i + 2) % 3] - x[(i + 2) % 3] * y[(i + 1) % 3];
   }
}
static void about(const double *axis, double angle, double *r) /* axis of length 1 */
{
   double c = cos(angle), s = sin(angle);
   int i, k;
   for (i = 0; i < 3; i++) for (k = 0; k < 3; k++) r[3 * i + k] = (1 - c) * axis[i] * axis[k] + (i == k ? c : 0);
   for (i = 0; i < 3; i++) { r[3 * i + (i + 1) % 3] -= s * axis[(i + 2) % 3]; r[3 * i + (i + 2) % 3] += s * axis[(i + 1) % 3]; }
}
/* the smallest rotation from direction a to direction b; the angle, 0 when one of them has no length */
static double between(const double *a, const double *b, double *r)
{
   double c[3], s, d = a[0] * b[0] + a[1] * b[1] + a[2] * b[2], angle;
   int i;
   memcpy(r, identity, sizeof identity);
   if (!(length(a) > 0 && length(b) > 0)) return 0;
   for (i = 0; i < 3; i++) c[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
   s = length(c);
   angle = atan2(s, d);
   if (!(s > 1e-9 * length(a) * length(b))) { /* along each other, or opposite: any axis across */
      double e[3] = {0, 0, 0};
      if (d >= 0) return 0;
      i = fabs(a[0]) < fabs(a[1]) ? (fabs(a[0]) < fabs(a[2]) ? 0 : 2) : (fabs(a[1]) < fabs(a[2]) ? 1 : 2);
      e[i] = 1;
      for (i = 0; i < 3; i++) c[i] = a[(i + 1) % 3] * e[(i + 2) % 3] - a[(i + 2) % 3] * e[(i + 1) % 3];
      s = length(c);
   }
   for (i = 0; i < 3; i++) c[i] /= s;
   about(c, angle, r);
   return angle;
}
void ex_quaternion(const float *m, float *q)
{
   double r[9], p[4] = {0, 0, 0, 1}, t, l;
   int i, k, j;
   for (i = 0; i < 9; i++) r[i] = (double)m[i];
   t = r[0] + r[4] + r[8];
   if (t > 0) { p[3] = 1 + t; p[0] = r[7] - r[5]; p[1] = r[2] - r[6]; p[2] = r[3] - r[1]; }
   else {
      i = r[0] > r[4] ? (r[0] > r[8] ? 0 : 2) : (r[4] > r[8] ? 1 : 2), j = (i + 1) % 3, k = (i + 2) % 3;
      p[i] = 1 + r[4 * i] - r[4 * j] - r[4 * k];
      p[j] = r[3 * j + i] + r[3 * i + j];
      p[k] = r[3 * k + i] + r[3 * i + k];
      p[3] = r[3 * k + j] - r[3 * j + k];
   }
   l = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2] + p[3] * p[3]);
   for (i = 0; i < 4; i++) q[i] = l > 0 ? (float)(p[i] / l) : i == 3 ? 1.0f : 0.0f;
}

/* ------------------------------------------------- clips */
static int same_name(const char *a, const char *b) /* the part after the prefix */
{
   a = ex_short_name(a);
   b = ex_short_name(b);
   while (*a && tolower((unsigned char)*a) == tolower((unsigned char)*b)) a++, b++;
   return !*a && !*b;
}
/* the node's rest, with the tracks of a frame over it */
static void local_at(const ex__clip *c, const float *rest, size_t node, size_t frame, double *m)
{
   float trs[10];
   size_t i;
   memcpy(trs, rest + 10 * node, sizeof trs);
   for (i = 0; frame != SIZE_MAX && i < c->tracks; i++) {
      const ex__track *t = &c->track[i];
      if (t->node != node) continue;
      memcpy(trs + (t->kind == 0 ? 0 : t->kind == 1 ? 3 : 7), t->values + (t->kind == 1 ? 4 : 3) * frame, (t->kind == 1 ? 4 : 3) * sizeof *trs);
   }
   ex__matrix(trs, m);
}
static int worlds(const ex__clip *c, size_t frame, double *world, unsigned char *done) /* (nodes,12) */
{
   size_t i, left = c->nodes;
   memset(done, 0, c->nodes);
   while (left) { /* parents may come after children in a file */
      size_t before = left;
      for (i = 0; i < c->nodes; i++) {
         double m[12];
         if (done[i] || (c->parents[i] >= 0 && !done[c->parents[i]])) continue;
         local_at(c, c->rest, i, frame, m);
         if (c->parents[i] < 0) memcpy(world + 12 * i, m, sizeof m);
         else ex__multiply(world + 12 * (size_t)c->parents[i], m, world + 12 * i);
         done[i] = 1;
         left--;
      }
      if (left == before) return 0;
   }
   return 1;
}
typedef struct pairing {
   int32_t *node;                /* (S) of the clip, or -1 */
   double *there;                /* (nodes,12) at rest */
   double *bridge;               /* (S,9) what brings the skeleton's bones into the clip's rest pose */
} pairing;

/* bones from joint to joint where both ends have a node; a joint with several such children has no one direction */
static void bridge_rests(const ex_skeleton *s, const pairing *p, ex_turns *out)
{
   size_t j, k, i;
   for (j = 0; j < s->joints; j++) {
      double *b = p->bridge + 9 * j, here[3], there[3], r[9], far = 20 * 3.14159265358979 / 180;
      size_t child = SIZE_MAX, children = 0;
      memcpy(b, s->parents[j] < 0 ? identity : p->bridge + 9 * (size_t)s->parents[j], sizeof identity);
      for (k = j + 1; k < s->joints; k++) if (s->parents[k] == (int32_t)j && p->node[k] >= 0) { child = k; children++; }
      if (p->node[j] < 0 || children != 1) continue;
      for (i = 0; i < 3; i++) {
         here[i] = 0;
         for (k = 0; k < 3; k++) here[i] += b[3 * i + k] * ((double)s->rest[3 * child + k] - (double)s->rest[3 * j + k]);
         there[i] = p->there[12 * (size_t)p->node[child] + 4 * i + 3] - p->there[12 * (size_t)p->node[j] + 4 * i + 3];
      }
      if (between(here, there, r) > far) {
         multiply(r, b, 0, 0, b);
         out->bridged++;
      }
   }
}
static double hip_ratio(const ex_skeleton *s, const pairing *p) /* heights of joint 0 over the lowest joint with a node */
{
   double here = 0, there = 0, y;
   size_t j;
   if (p->node[0] < 0) return 1;
   for (j = 0; j < s->joints; j++) {
      if (p->node[j] < 0) continue;
      y = (double)s->rest[1] - (double)s->rest[3 * j + 1];
      here = y > here ? y : here;
      y = p->there[12 * (size_t)p->node[0] + 7] - p->there[12 * (size_t)p->node[j] + 7];
      there = y > there ? y : there;
   }
   y = there > 0 ? here / there : 1;
   return y > 1e-3 && y < 1e3 ? y : 1;
}
static ex_turns *clip_turns(const char *path, const ex__clip *c, const ex_skeleton *s, char *error)
{
   size_t S = s->joints, N = c->nodes, i, j, f;
   ex_turns *out = turns_create(ex_short_name(c->name), c->frames, S);
   double *world = (double *)malloc((24 * N + 27 * S) * sizeof *world), *turn = world ? world + 24 * N + 9 * S : NULL, ratio;
   unsigned char *done = (unsigned char *)malloc(2 * N), *moved = done ? done + N : NULL;
   pairing p;
   int ok = 0;
   p.node = (int32_t *)malloc(S * sizeof *p.node);
   p.there = world ? world + 12 * N : NULL;
   p.bridge = world ? world + 24 * N : NULL;
   if (!out || !world || !done || !p.node) { ex_fail(error, path, "out of memory"); goto end; }
   memset(moved, 0, N);
   for (i = 0; i < c->tracks; i++) moved[c->track[i].node] = 1;
   for (j = 0; j < S; j++) {
      p.node[j] = -1;
      for (i = 0; i < N; i++) if (same_name(c->names[i], s->names[j]) && (p.node[j] < 0 || (moved[i] && !moved[p.node[j]]))) p.node[j] = (int32_t)i;
      if (p.node[j] >= 0 && moved[p.node[j]]) out->matched++;
   }
   if (!out->matched) {
      for (i = 0; i + 1 < N && !moved[i]; i++) {}
      ex_fail(error, path, "moves no joint of the model (it moves \"%.40s\", the model has \"%.40s\"): give --joints", c->names[i], s->names[0]);
      goto end;
   }
   if (!worlds(c, SIZE_MAX, p.there, done)) { ex_fail(error, path, "the nodes' parents form a circle"); goto end; }
   bridge_rests(s, &p, out);
   ratio = hip_ratio(s, &p);
   for (f = 0; f < c->frames; f++) {
      out->times[f] = c->times[f] - c->times[0];
      worlds(c, f, world, done);
      for (j = 0; j < S; j++) { /* G_j = D_node bridge_j; local = G_parent^T G_j */
         double *g = turn + 9 * j, at_rest[9], now[9], local[9];
         const double *up = s->parents[j] < 0 ? identity : turn + 9 * (size_t)s->parents[j];
         if (p.node[j] < 0) memcpy(g, up, sizeof identity);
         else {
            rotation_of(p.there + 12 * (size_t)p.node[j], at_rest);
            rotation_of(world + 12 * (size_t)p.node[j], now);
            multiply(now, at_rest, 0, 1, g);
            multiply(g, p.bridge + 9 * j, 0, 0, g);
         }
         multiply(up, g, 1, 0, local);
         for (i = 0; i < 9; i++) out->rotations[9 * (f * S + j) + i] = (float)local[i];
      }
      if (p.node[0] >= 0)
         for (i = 0; i < 3; i++) out->travel[3 * f + i] = (float)(ratio * (world[12 * (size_t)p.node[0] + 4 * i + 3] - p.there[12 * (size_t)p.node[0] + 4 * i + 3]));
   }
   ok = 1;
end:
   free(world); free(done); free(p.node);
   if (!ok) { ex_turns_free(out); out = NULL; }
   return out;
}

/* ------------------------------------------------- axis-angle */
static ex_turns *tensor_turns(const char *path, const ex_skeleton *s, char *error)
{
   ex_tensors *file = ex_tensors_open(path, error);
   ex_turns *out = NULL;
   const ex_tensor *t, *travel = NULL;
   const char *fps;
   float *v = NULL;
   size_t side[3], i, k, n;
   double rate = 30;
   int ok = 0;
   if (!file) return NULL;
   side[0] = 0, side[1] = s->joints, side[2] = 3;
   if (!(t = ex_tensors_get(file, "axis_angle", 3, side, error))) goto end;
   if (ex_tensors_find(file, "translation")) {
      side[0] = t->shape[0], side[1] = 3;
      if (!(travel = ex_tensors_get(file, "translation", 2, side, error))) goto end;
   }
   if (!t->shape[0]) { ex_fail(error, path, "has no frames"); goto end; }
   out = turns_create("axis_angle", t->shape[0], s->joints);
   v = (float *)malloc(t->count * sizeof *v);
   if (!out || !v) { ex_fail(error, path, "out of memory"); goto end; }
   out->matched = s->joints;
   ex_tensor_f32(t, v);
   if (travel) ex_tensor_f32(travel, out->travel);
   if ((fps = ex_tensors_meta(file, "fps")) != NULL) {
      for (rate = 0; *fps >= '0' && *fps <= '9' && rate < 1e6; fps++) rate = 10 * rate + (*fps - '0');
      if (!(rate >= 1 && rate < 1e6)) rate = 30;
   }
   for (n = 0; n < out->frames; n++) out->times[n] = (float)((double)n / rate);
   for (n = 0; n < out->frames * s->joints; n++) {
      double a[3], l, r[9];
      for (k = 0; k < 3; k++) a[k] = (double)v[3 * n + k];
      l = length(a);
      if (!(l < 1e6)) { ex_fail(error, path, "axis_angle: frame %lu, joint %lu is not a rotation", (unsigned long)(n / s->joints), (unsigned long)(n % s->joints)); goto end; }
      for (k = 0; k < 3; k++) a[k] = l > 0 ? a[k] / l : 0;
      about(a, l, r);
      for (k = 0; k < 9; k++) out->rotations[9 * n + k] = (float)r[k];
   }
   for (i = 0; i < 3 * out->frames; i++) if (!(fabsf(out->travel[i]) < 1e9f)) { ex_fail(error, path, "translation: frame %lu is %g", (unsigned long)(i / 3), (double)out->travel[i]); goto end; }
   ok = 1;
end:
   free(v);
   ex_tensors_close(file);
   if (!ok) { ex_turns_free(out); out = NULL; }
   return out;
}
ex_turns *ex_turns_load(const char *path, const char *which, const ex_skeleton *s, char *error)
{
   size_t n = strlen(path);
   ex_turns *out;
   ex__clip *c;
   if (n > 12 && strcmp(path + n - 12, ".safetensors") == 0) return tensor_turns(path, s, error);
   if (!(c = ex__gltf_clip(path, which, error))) return NULL;
   out = clip_turns(path, c, s, error);
   ex__clip_free(c);
   return out;
}
