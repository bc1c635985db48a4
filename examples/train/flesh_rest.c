/*  flesh_rest.c - the rest mesh as one welded surface, and what kind of thing each joint is

    in        an ex_scene            out   body: mesh, skeleton, parts, limbs, rigid ends
    parts     fingers move with their hand, toes with their foot, jaw and eyes with the head: these *rigid ends*
              stay as plain skinning has them, for a lattice of 2 cm has nothing to say about a finger
    limbs     bones along which twist is spread; see flesh_bones.c
    found     names help ("hand", "ForeArm"), geometry decides where they say nothing: an end is the topmost joint
              whose skin reaches less than 0.15 of the body's size from it; a limb is made of the long bones of the
              unbranched chain above an end */
#include "flesh.h"

static void scales(body *b)
{
   const ex_scene *s = b->scene;
   float *palette = NEW(float, 12 * s->joints);
   double m, lo[3], hi[3], size = 0;
   size_t i, k, c;
   double p[12];
   ex_pose_local(s, NULL, palette);
   for (c = 0; c + 1 < s->joints && !b->alive[c]; c++) {}
   for (k = 0; k < 12; k++) p[k] = (double)palette[12 * c + k]; /* rest palette: rotation times a scale, when the file's mesh is in other units */
   m = p[0] * (p[5] * p[10] - p[6] * p[9]) - p[1] * (p[4] * p[10] - p[6] * p[8]) + p[2] * (p[4] * p[9] - p[5] * p[8]);
   m = cbrt(fabs(m));
   if (!(m > 1e-9)) flesh_die("%s: the rest pose collapses", s->path);
   if (fabs(m - 1) < 1e-3) m = 1;
   for (k = 0; k < 3; k++) {
      lo[k] = hi[k] = s->positions[k];
      for (i = 0; i < s->vertices; i++) { double v = s->positions[3 * i + k]; lo[k] = v < lo[k] ? v : lo[k]; hi[k] = v > hi[k] ? v : hi[k]; }
      if ((hi[k] - lo[k]) * m > size) size = (hi[k] - lo[k]) * m;
   }
   if (!(size > 1e-9)) flesh_die("%s: all vertices are in one place", s->path);
   b->unit = size >= 0.8 && size <= 2.6 ? 1 : 1.75 / size; /* the parameters are for a body of human size */
   b->rest = m * b->unit;
   free(palette);
}

/* ------------------------------------------------- welding */
static uint64_t mix(uint64_t k) { k ^= k >> 31; k *= 0x9E3779B97F4A7C15ull; k ^= k >> 29; k *= 0xBF58476D1CE4E5B9ull; return k ^ k >> 32; }
static double weight_of(const body *b, int v, int j)
{
   double r = 0;
   int k;
   for (k = 0; k < b->influences; k++) if (b->vj[v * b->influences + k] == j) r += (double)b->vweight[v * b->influences + k];
   return r;
}
static double apart(const body *b, int u, int v) /* sum of absolute differences of the skin weights */
{
   double d = 0;
   int k;
   for (k = 0; k < b->influences; k++) {
      int j = b->vj[u * b->influences + k], i = b->vj[v * b->influences + k];
      if (b->vweight[u * b->influences + k] > 0) d += fabs(weight_of(b, u, j) - weight_of(b, v, j));
      if (b->vweight[v * b->influences + k] > 0 && weight_of(b, u, i) == 0) d += weight_of(b, v, i);
   }
   return d;
}
/* vertices at the same place that are skinned alike are one: UV seams must not open */
static void weld(body *b)
{
   const ex_scene *s = b->scene;
   size_t V = s->vertices, i, t, room = 16;
   int I = (int)s->influences, k, n = 0, *slot, kept = 0;
   while (room < 2 * V) room *= 2;
   slot = NEW(int, room);
   memset(slot, 0xff, room * sizeof *slot);
   b->of = NEW(int, V);
   b->pos = NEW(vec, V);
   b->influences = I;
   b->vj = NEW(int, V * (size_t)I);
   b->vweight = NEW(float, V * (size_t)I);
   for (i = 0; i < V; i++) {
      const float *p = s->positions + 3 * i;
      float f[3];
      uint32_t u[3];
      uint64_t key;
      double sum = 0;
      int at = -1;
      for (k = 0; k < 3; k++) f[k] = p[k] == 0 ? 0 : p[k]; /* -0 is 0 */
      memcpy(u, f, sizeof u);
      key = mix(mix(mix(u[0]) ^ u[1]) ^ u[2]) & (room - 1);
      b->pos[n] = vmul(vmake(p[0], p[1], p[2]), b->rest);
      for (k = 0; k < I; k++) { /* negative weights are dropped, the others sum to one */
         float w = s->skin_weights[i * (size_t)I + (size_t)k];
         b->vj[n * I + k] = (int)s->skin_joints[i * (size_t)I + (size_t)k];
         b->vweight[n * I + k] = w > 0 ? w : 0;
         sum += w > 0 ? (double)w : 0;
      }
      for (k = 0; k < I; k++) b->vweight[n * I + k] = sum > 0 ? (float)((double)b->vweight[n * I + k] / sum) : k == 0;
      for (; slot[key] >= 0; key = (key + 1) & (room - 1)) {
         vec d = vsub(b->pos[slot[key]], b->pos[n]);
         if (d.x == 0 && d.y == 0 && d.z == 0 && apart(b, slot[key], n) < 0.5) { at = slot[key]; break; }
      }
      if (at < 0) slot[key] = at = n++;
      b->of[i] = at;
   }
   b->vertices = n;
   b->tri = (int(*)[3])NEW(int, 3 * s->triangles);
   for (t = 0; t < s->triangles; t++) {
      int q[3];
      for (k = 0; k < 3; k++) q[k] = b->of[s->triangle[3 * t + (size_t)k]];
      if (q[0] == q[1] || q[1] == q[2] || q[2] == q[0]) continue;
      memcpy(b->tri[kept++], q, sizeof q);
   }
   b->triangles = kept;
   if (!kept) flesh_die("%s: every triangle is degenerate", s->path);
   free(slot);
}
static void adjacency(body *b)
{
   double volume = 0;
   int t, k, i, *fill, edges = 0;
   for (t = 0; t < b->triangles; t++) { const int *q = b->tri[t]; volume += vdot(b->pos[q[0]], vcross(b->pos[q[1]], b->pos[q[2]])); }
   if (volume < 0) /* an inside-out mesh */
      for (t = 0; t < b->triangles; t++) { int q = b->tri[t][1]; b->tri[t][1] = b->tri[t][2]; b->tri[t][2] = q; }
   b->area = NEW(double, b->vertices);
   b->adj0 = NEW(int, b->vertices + 1);
   b->adj = NEW(int, 6 * (size_t)b->triangles);
   fill = NEW(int, b->vertices);
   for (t = 0; t < b->triangles; t++) {
      const int *q = b->tri[t];
      double a = vlen(vcross(vsub(b->pos[q[1]], b->pos[q[0]]), vsub(b->pos[q[2]], b->pos[q[0]]))) / 6;
      for (k = 0; k < 3; k++) { b->area[q[k]] += a; b->adj0[q[k] + 1] += 2; }
   }
   for (i = 0; i < b->vertices; i++) b->adj0[i + 1] += b->adj0[i];
   for (t = 0; t < b->triangles; t++) for (k = 0; k < 3; k++) {
      int a = b->tri[t][k];
      b->adj[b->adj0[a] + fill[a]++] = b->tri[t][(k + 1) % 3];
      b->adj[b->adj0[a] + fill[a]++] = b->tri[t][(k + 2) % 3];
   }
   b->edge = NEW(int, 6 * (size_t)b->triangles);
   for (i = 0; i < b->vertices; i++) for (k = b->adj0[i]; k < b->adj0[i + 1]; k++) {
      int o = b->adj[k], l = b->adj0[i];
      while (b->adj[l] != o) l++;
      if (o > i && l == k) { b->edge[2 * edges] = i; b->edge[2 * edges++ + 1] = o; }
   }
   b->edges = edges;
   b->nrm = NEW(vec, b->vertices);
   flesh_normals(b, b->pos, b->nrm);
   free(fill);
}

/* ------------------------------------------------- what the joints are */
static int word(const ex_scene *s, int j, const char *what) /* the name contains it, in any case */
{
   const char *p, *a, *c;
   for (p = ex_short_name(s->names[j]); *p; p++) {
      for (a = p, c = what; *c && (*a == *c || (*a >= 'A' && *a <= 'Z' && *a + 32 == *c)); a++, c++) {}
      if (!*c) return 1;
   }
   return 0;
}
static void ends_and_groups(body *b, const double *below, double total)
{
   int S = b->joints, j, k, i;
   double size = 0, *reach = NEW(double, S);
   char *named = NEW(char, S);
   vec lo = b->pos[0], hi = lo;
   for (i = 0; i < b->vertices; i++) { lo = vmin(lo, b->pos[i]); hi = vmax(hi, b->pos[i]); }
   size = fmax(hi.x - lo.x, fmax(hi.y - lo.y, hi.z - lo.z));
   for (i = 0; i < b->vertices; i++) { /* how far a subtree's own skin reaches from its joint */
      int best = 0;
      for (k = 1; k < b->influences; k++) if (b->vweight[i * b->influences + k] > b->vweight[i * b->influences + best]) best = k;
      for (j = b->vj[i * b->influences + best]; j >= 0; j = b->parent[j]) reach[j] = fmax(reach[j], vlen(vsub(b->pos[i], b->joint[j])));
   }
   for (j = 0; j < S; j++) { /* parents come first: an ancestor's group is known */
      int up = b->parent[j], hint = b->o.names && (word(b->scene, j, "hand") || word(b->scene, j, "head") || word(b->scene, j, "foot"));
      b->group[j] = j;
      if (up >= 0 && b->end[b->group[up]]) { b->group[j] = b->group[up]; continue; }
      if (hint && b->alive[j] && below[j] < 0.35 * total) { b->end[j] = 1; for (k = j; k >= 0; k = b->parent[k]) named[k] = 1; }
   }
   for (j = 0; j < S; j++) { /* branches where names found nothing */
      int up = b->parent[j], leaf = 1;
      if (b->group[j] != j) continue;
      if (up >= 0 && b->end[b->group[up]]) { b->group[j] = b->group[up]; continue; }
      if (named[j] || !b->alive[j]) continue;
      for (k = j + 1; k < S; k++) if (b->parent[k] == j && b->alive[k]) leaf = 0;
      if (reach[j] < 0.15 * size || (leaf && S > 1)) b->end[j] = 1;
   }
   free(reach);
   free(named);
   /* the unbranched chain above each end: its long bones are a limb, the last of them twists with the end */
   for (k = 0; k < S; k++) {
      double longest = 0;
      int c, n, hinted = 0, last = 1, pass;
      if (!b->end[k]) continue;
      for (pass = 0; pass < 2; pass++) for (c = k, j = b->parent[k]; j >= 0; c = j, j = b->parent[j]) {
         double l = vlen(vsub(b->joint[c], b->joint[j]));
         int named_limb = b->o.names && (word(b->scene, j, "arm") || word(b->scene, j, "leg") || word(b->scene, j, "thigh") || word(b->scene, j, "calf") || word(b->scene, j, "shin"));
         for (n = 0, i = j + 1; i < S; i++) n += b->parent[i] == j && b->alive[i];
         if (n != 1) break;
         if (!pass) { longest = fmax(longest, l); hinted |= named_limb; continue; }
         if (hinted ? !named_limb : l < 0.6 * longest || l < 0.08 * size) continue;
         b->limb[j] = 1;
         if (last) b->twist[j] = 1;
         last = 0;
      }
   }
}
static void skeleton(body *b)
{
   const ex_scene *s = b->scene;
   int S = (int)s->joints, j, i;
   double *own = NEW(double, S), *below = NEW(double, S), total = 0;
   b->joints = S;
   b->parent = NEW(int, S); b->group = NEW(int, S); b->part = NEW(int, S); b->part_joint = NEW(int, S);
   b->end = NEW(char, S); b->limb = NEW(char, S); b->twist = NEW(char, S);
   b->joint = NEW(vec, S);
   for (j = 0; j < S; j++) {
      b->parent[j] = s->parents[j];
      b->joint[j] = vmul(vmake(s->joint_rest[3 * j], s->joint_rest[3 * j + 1], s->joint_rest[3 * j + 2]), b->rest);
   }
   for (i = 0; i < b->vertices * b->influences; i++) own[b->vj[i]] += (double)b->vweight[i] * (b->area[i / b->influences] + 1e-12);
   for (j = S - 1; j >= 0; j--) { total += own[j]; below[j] += own[j]; if (b->parent[j] >= 0) below[b->parent[j]] += below[j]; }
   ends_and_groups(b, below, total);
   for (j = 0; j < S; j++) b->part[j] = -1;
   for (j = 0; j < S; j++) {
      int g = b->group[j];
      double mass = own[j];
      if (g == j && b->end[j]) mass = below[j];
      if (g != j || !(mass > 0)) continue;
      b->part[j] = b->parts;
      b->part_joint[b->parts++] = j;
   }
   for (j = 0; j < S; j++) if (b->group[j] != j) b->part[j] = b->part[b->group[j]];
   free(own);
   free(below);
}
void flesh_rest(body *b, const ex_scene *s)
{
   size_t i;
   int j;
   b->scene = s;
   b->alive = NEW(char, s->joints);
   for (i = 0; i < s->vertices * s->influences; i++)
      if (s->skin_weights[i] > 0) for (j = (int)s->skin_joints[i]; j >= 0 && !b->alive[j]; j = s->parents[j]) b->alive[j] = 1;
   scales(b);
   weld(b);
   adjacency(b);
   skeleton(b);
   if (b->o.verbose) for (j = 0; j < b->parts; j++) {
      int k = b->part_joint[j];
      fprintf(stderr, "  part %-24s %s%s%s\n", ex_short_name(s->names[k]), b->end[k] ? "rigid end" : "", b->limb[k] ? "limb" : "", b->twist[k] ? ", twists with its end" : "");
   }
}
