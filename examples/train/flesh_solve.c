/*  flesh_solve.c - one pose: the node positions of least energy

    in        a body, the palettes of a frame         out   vertices, figures
    energy    stable neo-Hookean flesh, one quadrature point a cell (Smith, de Goes, Kim 2018, eq. 13)
              + hourglass stiffness + springs to bones, ends and plain skinning (flesh_bones.c) + contact
    solver    L-BFGS whose initial Hessian is the elastic Laplacian of the rest lattice with all springs, factorised
              once (Liu, Bouaziz, Kavan 2017): far fewer iterations than with a scaled identity
    contact   a skin vertex found inside a foreign cell is traced to its place in the rest body and pushed out
              through the nearest skin there (McAdams et al. 2011); searched again every few iterations
    settling  contacts that switch on and off at each search keep some poses moving for ever. Such a pose gets
              further iterations in which contacts are only added, and then none, so that a smooth problem is left
    repeats   the same bits for the same palettes and the same start, whatever thread runs it */
#include "flesh.h"
#include <time.h>

/* ------------------------------------------------- the constant system: skyline Cholesky */
static void ordering(body *b) /* reverse Cuthill-McKee from one end of each component along the longest axis */
{
   int M = b->nodes, C = b->cells, c, i, k, n = 0, *start = NEW(int, M + 2), *fill = NEW(int, M), *next, *order = NEW(int, M);
   char *seen = NEW(char, M);
   vec lo = b->x[0], hi = lo;
   int axis;
   for (i = 0; i < M; i++) { lo = vmin(lo, b->x[i]); hi = vmax(hi, b->x[i]); }
   axis = hi.y - lo.y >= hi.x - lo.x && hi.y - lo.y >= hi.z - lo.z ? 1 : hi.x - lo.x >= hi.z - lo.z ? 0 : 2;
   for (c = 0; c < C; c++) for (k = 0; k < 8; k++) start[b->cell[c].node[k] + 1] += 7;
   for (i = 0; i < M; i++) start[i + 1] += start[i];
   next = NEW(int, start[M]);
   for (c = 0; c < C; c++) for (k = 0; k < 8; k++) for (i = 0; i < 8; i++) if (i != k) { int a = b->cell[c].node[k]; next[start[a] + fill[a]++] = b->cell[c].node[i]; }
   b->perm = NEW(int, M);
   for (;;) {
      int top = -1, head = n;
      double best = -1e300;
      for (i = 0; i < M; i++) { double v = axis == 1 ? b->x[i].y : axis == 0 ? b->x[i].x : b->x[i].z; if (!seen[i] && v > best) { best = v; top = i; } }
      if (top < 0) break;
      order[n++] = top;
      seen[top] = 1;
      while (head < n) { int v = order[head++]; for (k = start[v]; k < start[v + 1]; k++) if (!seen[next[k]]) { seen[next[k]] = 1; order[n++] = next[k]; } }
   }
   for (i = 0; i < M; i++) b->perm[order[M - 1 - i]] = i;
   free(start); free(fill); free(next); free(order); free(seen);
}
void flesh_system(body *b)
{
   double h = b->h, w = b->o.w, kh = b->o.hourglass * h;
   int M = b->nodes, c, k, m, i, j;
   b->mu = 4. / 3; /* Smith's mu and lambda for a Lame mu of 1 */
   b->lambda = 2 * b->o.nu / (1 - 2 * b->o.nu) + 5. / 6;
   ordering(b);
   b->first = NEW(int, M);
   b->row = NEW(size_t, M + 1);
   for (i = 0; i < M; i++) b->first[i] = i;
   for (c = 0; c < b->cells; c++) for (k = 0; k < 8; k++) for (m = 0; m < 8; m++) {
      i = b->perm[b->cell[c].node[k]];
      j = b->perm[b->cell[c].node[m]];
      if (j < b->first[i]) b->first[i] = j;
   }
   for (i = 0; i < M; i++) b->row[i + 1] = b->row[i] + (size_t)(i - b->first[i] + 1);
   b->L = NEW(float, b->row[M]);
   for (c = 0; c < b->cells; c++) for (k = 0; k < 8; k++) for (m = 0; m < 8; m++) {
      int d = k ^ m, s = 3 - 2 * ((d & 1) + (d >> 1 & 1) + (d >> 2));
      i = b->perm[b->cell[c].node[k]];
      j = b->perm[b->cell[c].node[m]];
      if (j <= i) b->L[b->row[i] + (size_t)(j - b->first[i])] += (float)(b->cell[c].vol * (w * h * h * h / (16 * h * h) * s + kh * ((k == m) - (1 + s) / 8.)));
   }
   for (k = 0; k < M; k++) { i = b->perm[k]; b->L[b->row[i] + (size_t)(i - b->first[i])] += (float)(b->kb[k] + b->kr[k] + b->kt[k] + 1e-4 * h); }
   for (i = 0; i < M; i++) { /* L L^T in place, row by row */
      float *ri = b->L + b->row[i];
      for (j = b->first[i]; j <= i; j++) {
         float *rj = b->L + b->row[j], acc = 0, v;
         int s = b->first[i] > b->first[j] ? b->first[i] : b->first[j];
         const float *p = ri + (s - b->first[i]), *q = rj + (s - b->first[j]);
         for (k = 0; k < j - s; k++) acc += p[k] * q[k];
         v = ri[j - b->first[i]] - acc;
         if (j == i) { if (v <= 0) flesh_die("the elastic system is not positive definite: change --w or --tether"); ri[i - b->first[i]] = sqrtf(v); }
         else ri[j - b->first[i]] = v / rj[j - b->first[j]];
      }
   }
}
static void backsolve(solver *sv, const double *rhs, double *x) /* x = A^-1 rhs, three columns at once */
{
   const body *b = sv->b;
   int M = b->nodes, n, i, k;
   float *s0 = sv->s, *s1 = s0 + M, *s2 = s1 + M;
   for (n = 0; n < M; n++) { i = b->perm[n]; s0[i] = (float)rhs[3 * n]; s1[i] = (float)rhs[3 * n + 1]; s2[i] = (float)rhs[3 * n + 2]; }
   for (i = 0; i < M; i++) {
      const float *r = b->L + b->row[i];
      int f = b->first[i];
      float a = 0, c = 0, d = 0, q = 1 / r[i - f];
      const float *p0 = s0 + f, *p1 = s1 + f, *p2 = s2 + f;
      for (k = 0; k < i - f; k++) { a += r[k] * p0[k]; c += r[k] * p1[k]; d += r[k] * p2[k]; }
      s0[i] = (s0[i] - a) * q; s1[i] = (s1[i] - c) * q; s2[i] = (s2[i] - d) * q;
   }
   for (i = M - 1; i >= 0; i--) {
      const float *r = b->L + b->row[i];
      int f = b->first[i];
      float q = 1 / r[i - f], a = s0[i] *= q, c = s1[i] *= q, d = s2[i] *= q;
      float *p0 = s0 + f, *p1 = s1 + f, *p2 = s2 + f;
      for (k = 0; k < i - f; k++) { p0[k] -= r[k] * a; p1[k] -= r[k] * c; p2[k] -= r[k] * d; }
   }
   for (n = 0; n < M; n++) { i = b->perm[n]; x[3 * n] = s0[i]; x[3 * n + 1] = s1[i]; x[3 * n + 2] = s2[i]; }
}

/* ------------------------------------------------- contact */
static int ascending(const void *a, const void *b) { return *(const int *)a - *(const int *)b; }
static void contact_vertices(body *b) /* one vertex stands for the skin in each eighth of a cell */
{
   int room = 1 << 18, *slot, *key = NEW(int, b->vertices), i;
   while (room < 4 * b->vertices) room *= 2;
   slot = NEW(int, room);
   for (i = 0; i < room; i++) slot[i] = -1;
   b->cvert = NEW(int, b->vertices);
   b->carea = NEW(double, b->vertices);
   for (i = 0; i < b->vertices; i++) {
      vec q = vmul(vsub(b->pos[i], b->org), 2 / b->h);
      uint64_t k;
      int s;
      if (b->vc[i] < 0 || b->beta[i] > 0.9f) continue;
      k = (uint64_t)b->vc[i] * 8 + (uint64_t)(((int)q.x & 1) + 2 * ((int)q.y & 1) + 4 * ((int)q.z & 1));
      s = (int)(k * 0x9E3779B97F4A7C15ull >> 40) & (room - 1);
      while (slot[s] >= 0 && (uint64_t)b->vc[b->cvert[slot[s]]] * 8 + (uint64_t)key[slot[s]] != k) s = (s + 1) & (room - 1);
      if (slot[s] < 0) { slot[s] = b->cverts; key[b->cverts] = (int)(k & 7); b->cvert[b->cverts++] = i; }
      b->carea[slot[s]] += b->area[i];
   }
   free(slot);
   free(key);
}
void flesh_contacts(body *b)
{
   int C = b->cells, c, d, i, sweep, hops = (int)ceil(b->o.self / b->h), room = 0, *queue = NEW(int, C), *level = NEW(int, C);
   contact_vertices(b);
   /* the skin vertex nearest to each cell, handed on through the links so that it is the cell's own part */
   for (c = 0; c < C; c++) b->cell[c].nearest = -1;
   for (i = 0; i < b->vertices; i++) if (b->vc[i] >= 0) {
      int *v = &b->cell[b->vc[i]].nearest;
      vec m = flesh_centre(b, &b->cell[b->vc[i]]);
      if (*v < 0 || vlen(vsub(b->pos[i], m)) < vlen(vsub(b->pos[*v], m))) *v = i;
   }
   for (sweep = 0; sweep < 30; sweep++) {
      int changed = 0;
      for (c = 0; c < C; c++) for (d = 0; d < 6; d++) {
         int o = b->cell[c].link[d], *v = &b->cell[c].nearest;
         vec m = flesh_centre(b, &b->cell[c]);
         if (o < 0 || b->cell[o].nearest < 0) continue;
         if (*v < 0 || vlen(vsub(b->pos[b->cell[o].nearest], m)) < vlen(vsub(b->pos[*v], m)) - 1e-9) { *v = b->cell[o].nearest; changed = 1; }
      }
      if (!changed) break;
   }
   /* the own neighbourhood: cells within a few links, never in contact */
   b->near0 = NEW(int, C + 1);
   for (c = 0; c < C; c++) level[c] = -1;
   for (c = 0; c < C; c++) {
      int n = 0, head = 0, *list;
      queue[n++] = c;
      level[c] = 0;
      while (head < n) {
         int a = queue[head++];
         if (level[a] == hops) continue;
         for (d = 0; d < 6; d++) { int o = b->cell[a].link[d]; if (o >= 0 && level[o] < 0) { level[o] = level[a] + 1; queue[n++] = o; } }
      }
      if (b->near0[c] + n > room) {
         room = room ? room : 1 << 20;
         while (room < b->near0[c] + n) room *= 2;
         b->near = (int *)flesh_grow(b->near, (size_t)room, sizeof *b->near);
      }
      list = b->near + b->near0[c];
      for (i = 0; i < n; i++) { list[i] = queue[i]; level[queue[i]] = -1; }
      b->near0[c + 1] = b->near0[c] + n;
      qsort(list, (size_t)n, sizeof *list, ascending);
   }
   free(queue);
   free(level);
}
static int is_near(const body *b, int c, int o) { return bsearch(&o, b->near + b->near0[c], (size_t)(b->near0[c + 1] - b->near0[c]), sizeof(int), ascending) != NULL; }
vec flesh_embed(const body *b, const double *x, int v)
{
   vec r = {0, 0, 0};
   const int *node;
   int k;
   if (b->vc[v] < 0) return b->pos[v];
   node = b->cell[b->vc[v]].node;
   for (k = 0; k < 8; k++) { const double *p = x + 3 * node[k], w = b->vw[v][k]; r.x += w * p[0]; r.y += w * p[1]; r.z += w * p[2]; }
   return r;
}
enum { TABLE = 1 << 16 };
static unsigned hash(int x, int y, int z) { return ((unsigned)x * 73856093u ^ (unsigned)y * 19349663u ^ (unsigned)z * 83492791u) & (TABLE - 1); }
static void hash_cells(solver *s, const double *x, double g)
{
   const body *b = s->b;
   int c, k, i, n = 0, lo[3], hi[3];
   for (i = 0; i < TABLE; i++) s->head[i] = -1;
   for (c = 0; c < b->cells; c++) {
      vec l = vmake(1e9, 1e9, 1e9), u = vmake(-1e9, -1e9, -1e9);
      int X, Y, Z;
      for (k = 0; k < 8; k++) { const double *p = x + 3 * b->cell[c].node[k]; vec v = vmake(p[0], p[1], p[2]); l = vmin(l, v); u = vmax(u, v); }
      if (!(fabs(l.x) + fabs(l.y) + fabs(l.z) + fabs(u.x) + fabs(u.y) + fabs(u.z) < 1e6)) continue;
      lo[0] = (int)floor(l.x / g); lo[1] = (int)floor(l.y / g); lo[2] = (int)floor(l.z / g);
      hi[0] = (int)floor(u.x / g); hi[1] = (int)floor(u.y / g); hi[2] = (int)floor(u.z / g);
      if ((long)(hi[0] - lo[0] + 1) * (hi[1] - lo[1] + 1) * (hi[2] - lo[2] + 1) > 64) continue; /* torn out of shape */
      for (X = lo[0]; X <= hi[0]; X++) for (Y = lo[1]; Y <= hi[1]; Y++) for (Z = lo[2]; Z <= hi[2]; Z++) {
         unsigned slot = hash(X, Y, Z);
         if (n == s->hash_room) {
            s->hash_room = n ? 2 * n : 1 << 17;
            s->next = (int *)flesh_grow(s->next, (size_t)s->hash_room, sizeof *s->next);
            s->who = (int *)flesh_grow(s->who, (size_t)s->hash_room, sizeof *s->who);
         }
         s->who[n] = c;
         s->next[n] = s->head[slot];
         s->head[slot] = n++;
      }
   }
}
static void find_contacts(solver *s, const double *x)
{
   const body *b = s->b;
   double h = b->h, g = 1.5 * h, thick = b->o.thick;
   int ci, i, k, d, e;
   s->cons = 0;
   s->deepest = 0;
   for (i = 0; i < b->vertices; i++) s->skin[i] = flesh_embed(b, x, i);
   flesh_normals(b, s->skin, s->normal);
   hash_cells(s, x, g);
   for (ci = 0; ci < b->cverts; ci++) {
      int best = -1, last = -1;
      double deep = 0, off = thick, gap;
      vec p;
      i = b->cvert[ci];
      p = s->skin[i];
      if (!(fabs(p.x) + fabs(p.y) + fabs(p.z) < 1e6)) continue;
      for (e = s->head[hash((int)floor(p.x / g), (int)floor(p.y / g), (int)floor(p.z / g))]; e >= 0; e = s->next[e]) {
         int c = s->who[e], q, moved = 1, guard = 0;
         vec m = {0, 0, 0}, ax[3], c0, c1, c2, l, mx, r;
         double det;
         if (c == last || is_near(b, b->vc[i], c)) continue;
         last = c;
         memset(ax, 0, sizeof ax); /* p in the cell's own coordinates, by its affine part */
         for (k = 0; k < 8; k++) {
            const double *t = x + 3 * b->cell[c].node[k];
            vec v = vmake(t[0], t[1], t[2]);
            m = vadd(m, vmul(v, .125));
            for (d = 0; d < 3; d++) ax[d] = vadd(ax[d], vmul(v, (k >> d & 1 ? 1 : -1) / (4 * h)));
         }
         c0 = vcross(ax[1], ax[2]); c1 = vcross(ax[2], ax[0]); c2 = vcross(ax[0], ax[1]);
         det = vdot(ax[0], c0);
         if (det < 0.05) continue;
         r = vsub(p, m);
         l = vmake(vdot(c0, r) / det, vdot(c1, r) / det, vdot(c2, r) / det);
         if (fmax(fabs(l.x), fmax(fabs(l.y), fabs(l.z))) > 0.52 * h) continue;
         mx = vadd(flesh_centre(b, &b->cell[c]), l); /* its place in the rest body */
         q = b->cell[c].nearest;
         if (q < 0) continue;
         for (; moved && guard < 40; guard++) { /* walk down to the nearest skin vertex */
            double dq = vlen(vsub(b->pos[q], mx));
            int from = q;
            moved = 0;
            for (k = b->adj0[from]; k < b->adj0[from + 1]; k++) {
               double dd = vlen(vsub(b->pos[b->adj[k]], mx));
               if (dd < dq - 1e-12) { dq = dd; q = b->adj[k]; moved = 1; }
            }
         }
         if (vdot(vsub(mx, b->pos[q]), b->nrm[q]) > thick) continue; /* in the empty part of a surface cell */
         if (b->vc[q] < 0 || is_near(b, b->vc[i], b->vc[q])) continue;
         gap = vlen(vsub(mx, b->pos[q]));
         if (best < 0 || gap > deep) { best = q; deep = gap; }
      }
      if (best < 0) continue;
      if (vlen(vsub(b->pos[i], b->pos[best])) < 0.03) off = fmin(off, vdot(vsub(b->pos[i], b->pos[best]), b->nrm[best])); /* touching at rest */
      gap = vdot(vsub(p, s->skin[best]), s->normal[best]);
      if (vdot(s->normal[i], s->normal[best]) > 0.2) continue; /* layered cloth or a fold's far side: not facing */
      off = fmin(off, gap + deep + thick); /* never further than the way out in the rest body */
      if (gap >= off) continue;
      s->deepest = fmax(s->deepest, off - gap);
      if (s->cons == s->con_room) { s->con_room = s->con_room ? 2 * s->con_room : 4096; s->con = (contact *)flesh_grow(s->con, (size_t)s->con_room, sizeof *s->con); }
      { contact *t = &s->con[s->cons++]; t->p = i; t->q = best; t->n = s->normal[best]; t->k = b->o.contact * b->carea[ci] / h; t->off = off; }
   }
}

/*  the contacts of a new search join the ones held; where a vertex has both, the held one stays. The set can only
    grow, and one that no longer presses costs nothing, so nothing switches on and off any more */
static void add_contacts(solver *s, const double *x)
{
   int held = s->cons, i, n;
   contact *old = NEW(contact, held);
   char *has = NEW(char, s->b->vertices);
   if (held) memcpy(old, s->con, sizeof *old * (size_t)held);
   for (i = 0; i < held; i++) has[old[i].p] = 1;
   find_contacts(s, x);
   for (i = n = 0; i < s->cons; i++) if (!has[s->con[i].p]) s->con[n++] = s->con[i];
   if (n + held > s->con_room) { s->con_room = 2 * (n + held); s->con = (contact *)flesh_grow(s->con, (size_t)s->con_room, sizeof *s->con); }
   if (held) memcpy(s->con + n, old, sizeof *old * (size_t)held);
   s->cons = n + held;
   free(old);
   free(has);
}

/* ------------------------------------------------- energy and gradient */
static double energy(const solver *s, const double *x, double *g, double *volume)
{
   const body *b = s->b;
   double E = 0, h = b->h, V = h * h * h, mu = b->mu, la = b->lambda, al = 1 + 0.75 * mu / la, kh = b->o.hourglass * h, i4 = 1 / (4 * h), full = 0, rest = 0;
   int c, n, i, k, d, e, M = b->nodes;
   memset(g, 0, sizeof *g * 3 * (size_t)M);
   for (c = 0; c < b->cells; c++) {
      const int *node = b->cell[c].node;
      double vol = b->cell[c].vol, p[8][3], F[3][3], C[3][3], P[3][3], m[3], I = 0, J, f1, f2, hh = .5 * h;
      for (k = 0; k < 8; k++) for (d = 0; d < 3; d++) p[k][d] = x[3 * node[k] + d];
      for (d = 0; d < 3; d++) { /* F = dx/dX at the centre */
         double s0 = p[0][d] + p[1][d], s1 = p[2][d] + p[3][d], s2 = p[4][d] + p[5][d], s3 = p[6][d] + p[7][d];
         m[d] = (s0 + s1 + s2 + s3) * .125;
         F[d][0] = (p[1][d] - p[0][d] + p[3][d] - p[2][d] + p[5][d] - p[4][d] + p[7][d] - p[6][d]) * i4;
         F[d][1] = (s1 + s3 - s0 - s2) * i4;
         F[d][2] = (s2 + s3 - s0 - s1) * i4;
      }
      for (d = 0; d < 3; d++) for (e = 0; e < 3; e++) {
         int d1 = (d + 1) % 3, d2 = (d + 2) % 3, e1 = (e + 1) % 3, e2 = (e + 2) % 3;
         I += F[d][e] * F[d][e];
         C[d][e] = F[d1][e1] * F[d2][e2] - F[d1][e2] * F[d2][e1]; /* dJ/dF */
      }
      J = F[0][0] * C[0][0] + F[0][1] * C[0][1] + F[0][2] * C[0][2];
      full += vol * J;
      rest += vol;
      /* psi = mu/2 (I - 3) + lambda/2 (J - alpha)^2 - mu/2 log(I + 1) */
      E += vol * V * (.5 * mu * (I - 3) + .5 * la * (J - al) * (J - al) - .5 * mu * log(I + 1));
      f1 = mu * (1 - 1 / (I + 1));
      f2 = la * (J - al);
      for (d = 0; d < 3; d++) for (e = 0; e < 3; e++) P[d][e] = (f1 * F[d][e] + f2 * C[d][e]) * vol * V * i4;
      for (k = 0; k < 8; k++) {
         double sx = k & 1 ? 1 : -1, sy = k & 2 ? 1 : -1, sz = k & 4 ? 1 : -1;
         for (d = 0; d < 3; d++) {
            double r = p[k][d] - m[d] - hh * (F[d][0] * sx + F[d][1] * sy + F[d][2] * sz); /* what F does not explain */
            E += .5 * kh * vol * r * r;
            g[3 * node[k] + d] += P[d][0] * sx + P[d][1] * sy + P[d][2] * sz + kh * vol * r;
         }
      }
   }
   for (n = 0; n < M; n++) {
      vec y = vmake(x[3 * n], x[3 * n + 1], x[3 * n + 2]), a = vsub(y, s->target[n]), t = vsub(y, s->plain[n]);
      E += .5 * s->k[n] * vdot(a, a) + .5 * b->kt[n] * vdot(t, t);
      g[3 * n] += s->k[n] * a.x + b->kt[n] * t.x;
      g[3 * n + 1] += s->k[n] * a.y + b->kt[n] * t.y;
      g[3 * n + 2] += s->k[n] * a.z + b->kt[n] * t.z;
   }
   for (i = 0; i < s->cons; i++) {
      const contact *t = &s->con[i];
      double gap = vdot(vsub(flesh_embed(b, x, t->p), flesh_embed(b, x, t->q)), t->n) - t->off;
      vec f;
      if (gap >= 0) continue;
      E += .5 * t->k * gap * gap;
      f = vmul(t->n, t->k * gap);
      for (k = 0; k < 8; k++) {
         double *u = g + 3 * b->cell[b->vc[t->p]].node[k], *v = g + 3 * b->cell[b->vc[t->q]].node[k], wu = b->vw[t->p][k], wv = b->vw[t->q][k];
         u[0] += wu * f.x; u[1] += wu * f.y; u[2] += wu * f.z;
         v[0] -= wv * f.x; v[1] -= wv * f.y; v[2] -= wv * f.z;
      }
   }
   if (volume) *volume = full / rest - 1;
   return E;
}

/* ------------------------------------------------- L-BFGS */
static double dot(const double *a, const double *b, int n) { double s = 0; int i; for (i = 0; i < n; i++) s += a[i] * b[i]; return s; }
static void minimise(solver *sv, figures *f)
{
   const body *b = sv->b;
   const flesh_options *o = &b->o;
   int n = 3 * b->nodes, K = o->memory, used = 0, top = 0, it, k, q, total = o->iters, frozen = 0;
   double *x = sv->x, *g = sv->g, *g2 = sv->g2, *d = sv->d, *x2 = sv->x2, rho[64], al[64], E = 0, moved = 1e9;
   for (it = 0; it < total; it++) {
      double slope, t = 1, E2 = 0, big = 0, sy, *s, *y;
      int tries;
      if (it % o->refresh == 0 && !(frozen && it >= total - o->frozen / 2)) {
         if (o->contact > 0) { if (frozen) add_contacts(sv, x); else find_contacts(sv, x); }
         E = energy(sv, x, g, NULL);
         f->evaluations++;
      }
      memcpy(d, g, sizeof *d * (size_t)n); /* two-loop recursion, H0 = A^-1 */
      for (k = 0; k < used; k++) {
         int i = (top - 1 - k + 2 * K) % K;
         const double *yi = sv->ly + (size_t)i * (size_t)n;
         double a = al[i] = rho[i] * dot(sv->ls + (size_t)i * (size_t)n, d, n);
         for (q = 0; q < n; q++) d[q] -= a * yi[q];
      }
      backsolve(sv, d, x2);
      memcpy(d, x2, sizeof *d * (size_t)n);
      for (k = used - 1; k >= 0; k--) {
         int i = (top - 1 - k + 2 * K) % K;
         const double *si = sv->ls + (size_t)i * (size_t)n;
         double a = al[i] - rho[i] * dot(sv->ly + (size_t)i * (size_t)n, d, n);
         for (q = 0; q < n; q++) d[q] += a * si[q];
      }
      slope = -dot(g, d, n);
      if (slope >= 0) { used = top = 0; backsolve(sv, g, d); slope = -dot(g, d, n); }
      for (q = 0; q < n; q++) big = fmax(big, fabs(d[q]));
      if (big > 0.05) t = 0.05 / big; /* at most 5 cm a step */
      for (tries = 0; tries < 10; tries++) { /* Armijo */
         for (q = 0; q < n; q++) x2[q] = x[q] - t * d[q];
         E2 = energy(sv, x2, g2, NULL);
         f->evaluations++;
         if (E2 <= E + 1e-4 * t * slope) break;
         t *= tries ? 0.4 : 0.5;
      }
      f->iterations++;
      if (tries == 10) { /* no descent: forget the past; with no past, wait for the next search for contacts */
         if (!used && frozen) break;
         if (!used) it += o->refresh - 1 - it % o->refresh;
         used = top = 0;
      } else {
         moved = t * big;
         s = sv->ls + (size_t)top * (size_t)n;
         y = sv->ly + (size_t)top * (size_t)n;
         for (q = 0; q < n; q++) { s[q] = x2[q] - x[q]; y[q] = g2[q] - g[q]; }
         sy = dot(s, y, n);
         if (sy > 1e-18) { rho[top] = 1 / sy; top = (top + 1) % K; if (used < K) used++; }
         memcpy(x, x2, sizeof *x * (size_t)n);
         memcpy(g, g2, sizeof *g * (size_t)n);
         E = E2;
         if (o->verbose > 1) fprintf(stderr, "   it %d E %.9g step %.2g mm t %.3g contacts %d deepest %.1f mm\n", it, E, 1e3 * moved, t, sv->cons, 1e3 * sv->deepest);
         if (moved < 5e-5 && it > o->refresh) break; /* 0.05 mm */
      }
      if (it + 1 >= total && !frozen && o->frozen > 0 && 1e3 * moved > o->bar) { /* not settled */
         frozen = 1;
         used = top = 0;
         total = it + 1 + o->frozen;
      }
   }
   f->energy = (float)E;
   f->contacts = sv->cons;
   f->deepest_mm = (float)(1e3 * sv->deepest);
   f->step_mm = (float)(1e3 * moved);
}

/* ------------------------------------------------- a pose */
solver *flesh_solver(const body *b)
{
   solver *s = NEW(solver, 1);
   size_t M = (size_t)b->nodes, N = (size_t)b->vertices, i;
   s->b = b;
   s->A = NEW(double, 12 * b->joints); s->q = NEW(quat, b->joints); s->p = NEW(vec, b->joints);
   s->target = NEW(vec, M); s->plain = NEW(vec, M); s->k = NEW(double, M);
   s->x = NEW(double, 3 * M); s->g = NEW(double, 3 * M); s->g2 = NEW(double, 3 * M); s->d = NEW(double, 3 * M); s->x2 = NEW(double, 3 * M);
   s->ls = NEW(double, 3 * M * (size_t)b->o.memory); s->ly = NEW(double, 3 * M * (size_t)b->o.memory);
   s->s = NEW(float, 3 * M); s->off = NEW(vec, M);
   s->skin = NEW(vec, N); s->normal = NEW(vec, N); s->tmp = NEW(vec, N); s->out = NEW(vec, N); s->lbs = NEW(vec, N);
   s->head = NEW(int, TABLE);
   for (i = 0; i < M; i++) s->k[i] = b->kb[i] + b->kr[i];
   return s;
}
void flesh_solver_free(solver *s)
{
   if (!s) return;
   free(s->A); free(s->q); free(s->p); free(s->target); free(s->plain); free(s->k); free(s->x); free(s->g); free(s->g2); free(s->d); free(s->x2);
   free(s->ls); free(s->ly); free(s->s); free(s->off); free(s->con); free(s->skin); free(s->normal); free(s->tmp); free(s->out); free(s->lbs);
   free(s->head); free(s->next); free(s->who);
   free(s);
}
static quat rotation(const double *m) /* of a palette: its columns made orthonormal first */
{
   vec a = vunit(vmake(m[0], m[4], m[8])), c = vmake(m[1], m[5], m[9]), e;
   quat q;
   double r[9], t;
   c = vunit(vsub(c, vmul(a, vdot(a, c))));
   e = vcross(a, c);
   r[0] = a.x; r[1] = c.x; r[2] = e.x; r[3] = a.y; r[4] = c.y; r[5] = e.y; r[6] = a.z; r[7] = c.z; r[8] = e.z;
   t = r[0] + r[4] + r[8];
   if (t > 0) { q.w = 1 + t; q.x = r[7] - r[5]; q.y = r[2] - r[6]; q.z = r[3] - r[1]; }
   else if (r[0] > r[4] && r[0] > r[8]) { q.x = 1 + r[0] - r[4] - r[8]; q.y = r[3] + r[1]; q.z = r[2] + r[6]; q.w = r[7] - r[5]; }
   else if (r[4] > r[8]) { q.y = 1 + r[4] - r[0] - r[8]; q.x = r[3] + r[1]; q.z = r[7] + r[5]; q.w = r[2] - r[6]; }
   else { q.z = 1 + r[8] - r[0] - r[4]; q.x = r[2] + r[6]; q.y = r[7] + r[5]; q.w = r[3] - r[1]; }
   return qnorm(q);
}
static void pose(solver *s, const float *palette) /* palettes act on the mesh's units; ours on work space */
{
   const body *b = s->b;
   int j, k;
   for (j = 0; j < b->joints; j++) {
      double *m = s->A + 12 * (size_t)j;
      for (k = 0; k < 12; k++) m[k] = (double)palette[12 * j + k] * (k % 4 == 3 ? b->unit : b->unit / b->rest);
      s->q[j] = rotation(m);
      s->p[j] = carry(s->A, j, b->joint[j]);
   }
}
static int finite_all(const double *x, int n) /* by bits: this file may be compiled with -ffast-math */
{
   int i;
   for (i = 0; i < n; i++) { uint64_t u; memcpy(&u, &x[i], 8); if ((u >> 52 & 0x7ff) == 0x7ff) return 0; }
   return 1;
}
void flesh_solve(solver *s, const float *palette, int restart, float *out, figures *f)
{
   const body *b = s->b;
   int M = b->nodes, N = b->vertices, P = b->parts, i, k, p, sane;
   struct timespec t0, t1;
   double volume = 0;
   clock_gettime(CLOCK_MONOTONIC, &t0);
   memset(f, 0, sizeof *f);
   if (restart) memset(s->off, 0, sizeof *s->off * (size_t)M);
   pose(s, palette);
   for (i = 0; i < M; i++) {
      const float *w = b->nw + (size_t)i * (size_t)P;
      vec l = {0, 0, 0}, start;
      for (p = 0; p < P; p++) if (w[p] > 0) l = vadd(l, vmul(carry(s->A, b->part_joint[p], b->x[i]), w[p]));
      s->plain[i] = s->target[i] = l;
      if (s->k[i] > 0) {
         vec u = b->kb[i] > 0 ? flesh_bone_target(s, &b->nb[i], b->x[i]) : l, v = b->kr[i] > 0 ? carry(s->A, b->rj[i], b->x[i]) : l;
         s->target[i] = vmul(vadd(vmul(u, b->kb[i]), vmul(v, b->kr[i])), 1 / s->k[i]);
      }
      start = vadd(l, qrot(flesh_node_rotation(s, i), s->off[i]));
      s->x[3 * i] = start.x; s->x[3 * i + 1] = start.y; s->x[3 * i + 2] = start.z;
   }
   minimise(s, f);
   sane = finite_all(s->x, 3 * M);
   for (i = 0; i < M; i++) {
      vec d = vsub(vmake(s->x[3 * i], s->x[3 * i + 1], s->x[3 * i + 2]), s->plain[i]);
      s->off[i] = sane ? qrot(qconj(flesh_node_rotation(s, i)), d) : vmake(0, 0, 0);
   }
   energy(s, s->x, s->g, &volume);
   for (i = 0; i < N; i++) {
      vec l = {0, 0, 0};
      for (k = 0; k < b->influences; k++) { float w = b->vweight[i * b->influences + k]; if (w > 0) l = vadd(l, vmul(carry(s->A, b->vj[i * b->influences + k], b->pos[i]), w)); }
      s->lbs[i] = l;
      s->out[i] = b->vc[i] < 0 ? l : flesh_embed(b, s->x, i);
   }
   flesh_smooth(b, s->out, s->tmp, s->normal, s->skin);
   for (i = 0; i < N; i++) s->out[i] = sane ? vadd(vmul(s->out[i], 1 - b->beta[i]), vmul(s->lbs[i], b->beta[i])) : s->lbs[i];
   for (i = 0; i < (int)b->scene->vertices; i++) {
      vec v = vmul(s->out[b->of[i]], 1 / b->unit);
      out[3 * i] = (float)v.x; out[3 * i + 1] = (float)v.y; out[3 * i + 2] = (float)v.z;
   }
   f->volume = (float)volume;
   f->stretch = (float)flesh_stretch(b, s->out);
   f->crossings_before = flesh_crossings(s, s->lbs, NULL);
   f->crossings_after = flesh_crossings(s, s->out, NULL);
   f->settled = sane && (double)f->step_mm <= b->o.bar;
   clock_gettime(CLOCK_MONOTONIC, &t1);
   f->seconds = (double)(t1.tv_sec - t0.tv_sec) + 1e-9 * (double)(t1.tv_nsec - t0.tv_nsec);
}
