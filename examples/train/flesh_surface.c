/*  flesh_surface.c - the skin: smoothing that hides the cells, and figures that judge a pose

    smoothing  Delta Mush (Mancewicz et al. 2014) of a few passes: the rest mesh's detail, kept in the frames of
               the smoothed rest mesh, is put back on the smoothed posed mesh
    crossings  vertices with an edge that pierces a triangle, other than those that do so at rest; measured on the
               surface alone, so that it judges skinning and solver alike */
#include "flesh.h"

void flesh_normals(const body *b, const vec *p, vec *n)
{
   int t, k, i;
   memset(n, 0, sizeof *n * (size_t)b->vertices);
   for (t = 0; t < b->triangles; t++) {
      const int *q = b->tri[t];
      vec c = vcross(vsub(p[q[1]], p[q[0]]), vsub(p[q[2]], p[q[0]]));
      for (k = 0; k < 3; k++) n[q[k]] = vadd(n[q[k]], c);
   }
   for (i = 0; i < b->vertices; i++) n[i] = vunit(n[i]);
}
static void pass(const body *b, vec *p, vec *tmp) /* every vertex to the mean of its one-ring */
{
   int i, k;
   for (i = 0; i < b->vertices; i++) {
      vec s = {0, 0, 0};
      int n = b->adj0[i + 1] - b->adj0[i];
      for (k = b->adj0[i]; k < b->adj0[i + 1]; k++) s = vadd(s, p[b->adj[k]]);
      tmp[i] = n ? vmul(s, 1. / n) : p[i];
   }
   memcpy(p, tmp, sizeof *p * (size_t)b->vertices);
}
static void frame(const body *b, const vec *p, int i, vec n, vec *t, vec *u)
{
   int o = b->adj0[i + 1] > b->adj0[i] ? b->adj[b->adj0[i]] : i;
   vec e = vsub(p[o], p[i]);
   *t = vunit(vsub(e, vmul(n, vdot(e, n))));
   *u = vcross(n, *t);
}
void flesh_smooth(const body *b, vec *p, vec *tmp, vec *n, vec *work)
{
   int i;
   if (!b->o.mush) return;
   memcpy(work, p, sizeof *p * (size_t)b->vertices);
   for (i = 0; i < b->o.mush; i++) pass(b, work, tmp);
   flesh_normals(b, work, n);
   for (i = 0; i < b->vertices; i++) {
      vec t, u, d = b->mush[i];
      frame(b, work, i, n[i], &t, &u);
      p[i] = vadd(work[i], vadd(vadd(vmul(t, d.x), vmul(u, d.y)), vmul(n[i], d.z)));
   }
}
double flesh_stretch(const body *b, const vec *p)
{
   double most = 0;
   int e;
   for (e = 0; e < b->edges; e++) {
      int i = b->edge[2 * e], k = b->edge[2 * e + 1];
      double rest = vlen(vsub(b->pos[i], b->pos[k]));
      if (rest > 1e-4) most = fmax(most, vlen(vsub(p[i], p[k])) / rest); /* 0.1 mm: shorter ones are noise */
   }
   return most;
}

/* ------------------------------------------------- crossings */
static int pierces(vec a, vec d, const vec *p, const int *q) /* the segment a..a+d through a triangle (Moeller, Trumbore) */
{
   vec e = vsub(p[q[1]], p[q[0]]), f = vsub(p[q[2]], p[q[0]]), h = vcross(d, f), s, r;
   double det = vdot(e, h), u, v, t;
   if (fabs(det) < 1e-18) return 0;
   s = vsub(a, p[q[0]]);
   u = vdot(s, h) / det;
   if (u < 0 || u > 1) return 0;
   r = vcross(s, e);
   v = vdot(d, r) / det;
   if (v < 0 || u + v > 1) return 0;
   t = vdot(f, r) / det;
   return t >= 0 && t <= 1;
}
enum { TABLE = 1 << 16 };
static unsigned hash(int x, int y, int z) { return ((unsigned)x * 73856093u ^ (unsigned)y * 19349663u ^ (unsigned)z * 83492791u) & (TABLE - 1); }
static void boxed(vec lo, vec hi, double g, int *a, int *z)
{
   a[0] = (int)floor(lo.x / g); a[1] = (int)floor(lo.y / g); a[2] = (int)floor(lo.z / g);
   z[0] = (int)floor(hi.x / g); z[1] = (int)floor(hi.y / g); z[2] = (int)floor(hi.z / g);
}
int flesh_crossings(solver *s, const vec *p, char *crossed)
{
   const body *b = s->b;
   double g = 0.02;
   int t, e, k, n = 0, count = 0, a[3], z[3], x, y, w, i;
   char *hit = NEW(char, b->vertices);
   for (i = 0; i < TABLE; i++) s->head[i] = -1;
   for (t = 0; t < b->triangles; t++) {
      const int *q = b->tri[t];
      vec lo = vmin(p[q[0]], vmin(p[q[1]], p[q[2]])), hi = vmax(p[q[0]], vmax(p[q[1]], p[q[2]]));
      if (!(fabs(lo.x) + fabs(lo.y) + fabs(lo.z) + fabs(hi.x) + fabs(hi.y) + fabs(hi.z) < 1e6)) continue;
      boxed(lo, hi, g, a, z);
      if ((long)(z[0] - a[0] + 1) * (z[1] - a[1] + 1) * (z[2] - a[2] + 1) > 4096) continue;
      for (x = a[0]; x <= z[0]; x++) for (y = a[1]; y <= z[1]; y++) for (w = a[2]; w <= z[2]; w++) {
         unsigned slot = hash(x, y, w);
         if (n == s->hash_room) {
            s->hash_room = n ? 2 * n : 1 << 17;
            s->next = (int *)flesh_grow(s->next, (size_t)s->hash_room, sizeof *s->next);
            s->who = (int *)flesh_grow(s->who, (size_t)s->hash_room, sizeof *s->who);
         }
         s->who[n] = t;
         s->next[n] = s->head[slot];
         s->head[slot] = n++;
      }
   }
   for (e = 0; e < b->edges; e++) {
      int i0 = b->edge[2 * e], i1 = b->edge[2 * e + 1], found = 0;
      vec A = p[i0], d = vsub(p[i1], A), lo = vmin(A, p[i1]), hi = vmax(A, p[i1]);
      if (!(fabs(lo.x) + fabs(lo.y) + fabs(lo.z) + fabs(hi.x) + fabs(hi.y) + fabs(hi.z) < 1e6)) continue;
      boxed(lo, hi, g, a, z);
      if ((long)(z[0] - a[0] + 1) * (z[1] - a[1] + 1) * (z[2] - a[2] + 1) > 4096) continue;
      for (x = a[0]; x <= z[0] && !found; x++) for (y = a[1]; y <= z[1] && !found; y++) for (w = a[2]; w <= z[2] && !found; w++)
         for (k = s->head[hash(x, y, w)]; k >= 0 && !found; k = s->next[k]) {
            const int *q = b->tri[s->who[k]];
            if (q[0] == i0 || q[1] == i0 || q[2] == i0 || q[0] == i1 || q[1] == i1 || q[2] == i1) continue;
            found = pierces(A, d, p, q);
         }
      if (found) hit[i0] = hit[i1] = 1;
   }
   for (i = 0; i < b->vertices; i++) count += hit[i] && !(b->crossed && b->crossed[i]);
   if (crossed) memcpy(crossed, hit, (size_t)b->vertices);
   free(hit);
   return count;
}
void flesh_surface(body *b)
{
   int i;
   vec *q = NEW(vec, b->vertices), *tmp = NEW(vec, b->vertices), *n = NEW(vec, b->vertices);
   solver s;
   char *crossed = NEW(char, b->vertices);
   b->mush = NEW(vec, b->vertices);
   memcpy(q, b->pos, sizeof *q * (size_t)b->vertices);
   for (i = 0; i < b->o.mush; i++) pass(b, q, tmp);
   flesh_normals(b, q, n);
   for (i = 0; i < b->vertices; i++) {
      vec t, u, d = vsub(b->pos[i], q[i]);
      frame(b, q, i, n[i], &t, &u);
      b->mush[i] = vmake(vdot(d, t), vdot(d, u), vdot(d, n[i]));
   }
   memset(&s, 0, sizeof s);
   s.b = b;
   s.head = NEW(int, TABLE);
   flesh_crossings(&s, b->pos, crossed);
   b->crossed = crossed;
   free(s.head); free(s.next); free(s.who); free(q); free(tmp); free(n);
}
