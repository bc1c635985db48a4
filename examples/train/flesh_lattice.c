/*  flesh_lattice.c - the rest solid as cells, one instance of a cell for each body part in it

    in        body after flesh_rest            out   cells, nodes, embedding of the vertices
    why       an arm that touches the flank at rest, or two thighs, share cells of a plain voxel grid and would be
              glued. So a cell is split by its skin weights: samples of the surface whose weights differ by more
              than half of all weight open another instance, neighbours are glued only where their weights agree,
              and corners that end up glued become one node (union-find)
    inside    by the generalised winding number, which copes with clothes that are open at the hem
    embedding a vertex is carried by the instance most like it, trilinearly */
#include "flesh.h"

static int place(const body *b, int x, int y, int z) { return (z * b->ny + y) * b->nx + x; }
static double apart(const body *b, const float *u, const float *v)
{
   double s = 0;
   int p;
   for (p = 0; p < b->parts; p++) s += fabs(u[p] - v[p]);
   return s;
}
void flesh_part_weights(const body *b, int v, float *w)
{
   int k;
   memset(w, 0, sizeof *w * (size_t)b->parts);
   for (k = 0; k < b->influences; k++) {
      float x = b->vweight[v * b->influences + k];
      if (x > 0) w[b->part[b->vj[v * b->influences + k]]] += x;
   }
}
static float *cell_weights(const body *b, int c) { return b->cw + (size_t)c * (size_t)b->parts; }
static int new_cell(body *b, int x, int y, int z)
{
   cell *c;
   int *first = &b->grid[place(b, x, y, z)];
   if (b->cells == b->cell_room) {
      b->cell_room = b->cell_room ? 2 * b->cell_room : 8192;
      if (b->cell_room > 1 << 20) flesh_die("%s needs more than a million cells of %g m: raise --cell", b->scene->path, b->h);
      b->cell = (cell *)flesh_grow(b->cell, (size_t)b->cell_room, sizeof *b->cell);
      b->cw = (float *)flesh_grow(b->cw, (size_t)b->cell_room * (size_t)b->parts, sizeof *b->cw);
   }
   c = &b->cell[b->cells];
   memset(c, 0, sizeof *c);
   memset(cell_weights(b, b->cells), 0, sizeof *b->cw * (size_t)b->parts);
   c->x = x; c->y = y; c->z = z;
   c->next = *first;
   *first = b->cells;
   return b->cells++;
}
vec flesh_centre(const body *b, const cell *c) { return vadd(b->org, vmake((c->x + .5) * b->h, (c->y + .5) * b->h, (c->z + .5) * b->h)); }

/* every triangle is sampled densely; each sample joins the instance with its weights, or opens one */
static void surface_cells(body *b)
{
   vec lo = b->pos[0], hi = lo;
   double h = b->o.cell, size[3], volume = 0, area = 0, guess;
   int P = b->parts, i, k, t, p;
   float *W = NEW(float, (size_t)b->vertices * (size_t)P), *w = NEW(float, P);
   for (i = 0; i < b->vertices; i++) { lo = vmin(lo, b->pos[i]); hi = vmax(hi, b->pos[i]); flesh_part_weights(b, i, W + (size_t)i * (size_t)P); }
   for (t = 0; t < b->triangles; t++) {
      vec A = b->pos[b->tri[t][0]], B = b->pos[b->tri[t][1]], C = b->pos[b->tri[t][2]];
      volume += vdot(A, vcross(B, C)) / 6;
      area += vlen(vcross(vsub(B, A), vsub(C, A))) / 2;
   }
   /* a suit on a tall man makes 20,000 cells; time and memory grow with their 7/3 power, so stout figures get
      larger ones */
   guess = fabs(volume) / (h * h * h) + area / (h * h);
   if (guess > b->o.cells) { h *= cbrt(guess / b->o.cells); fprintf(stderr, "%s is large: cells of %.1f mm instead of %.1f (--cells)\n", b->scene->path, 1e3 * h, 1e3 * b->o.cell); }
   b->h = h;
   b->org = vsub(lo, vmake(1.5 * h, 1.5 * h, 1.5 * h));
   size[0] = (hi.x - b->org.x) / h; size[1] = (hi.y - b->org.y) / h; size[2] = (hi.z - b->org.z) / h;
   if ((size[0] + 3) * (size[1] + 3) * (size[2] + 3) > 3e7) flesh_die("%s spans %.0f x %.0f x %.0f cells of %g m: raise --cell", b->scene->path, size[0], size[1], size[2], h);
   b->nx = (int)size[0] + 3; b->ny = (int)size[1] + 3; b->nz = (int)size[2] + 3;
   b->grid = NEW(int, b->nx * b->ny * b->nz);
   for (i = 0; i < b->nx * b->ny * b->nz; i++) b->grid[i] = -1;
   for (t = 0; t < b->triangles; t++) {
      const int *q = b->tri[t];
      vec A = b->pos[q[0]], B = b->pos[q[1]], C = b->pos[q[2]], fn = vunit(vcross(vsub(B, A), vsub(C, A)));
      double L = fmax(vlen(vsub(B, A)), fmax(vlen(vsub(C, A)), vlen(vsub(C, B))));
      const float *wa = W + (size_t)q[0] * (size_t)P, *wb = W + (size_t)q[1] * (size_t)P, *wc = W + (size_t)q[2] * (size_t)P;
      int n = (int)ceil(L / (h * 0.3));
      if (n < 1) n = 1;
      for (i = 0; i <= n; i++) for (k = 0; k <= n - i; k++) {
         double u = (double)i / n, v = (double)k / n, s = 1 - u - v, best_d = 1.0;
         vec x = vadd(vadd(vmul(A, s), vmul(B, u)), vmul(C, v)), g = vmul(vsub(x, b->org), 1 / h);
         int best = -1, c;
         float f, *cw;
         cell *into;
         for (p = 0; p < P; p++) w[p] = (float)(s * (double)wa[p] + u * (double)wb[p] + v * (double)wc[p]);
         for (c = b->grid[place(b, (int)g.x, (int)g.y, (int)g.z)]; c >= 0; c = b->cell[c].next) {
            double d = apart(b, cell_weights(b, c), w);
            if (d < best_d) { best_d = d; best = c; }
         }
         if (best < 0) best = new_cell(b, (int)g.x, (int)g.y, (int)g.z);
         into = &b->cell[best];
         cw = cell_weights(b, best);
         f = 1 / (into->count + 1); /* running means */
         for (p = 0; p < P; p++) cw[p] += (w[p] - cw[p]) * f;
         into->p = vadd(into->p, vmul(vsub(x, into->p), f));
         into->n = vadd(into->n, vmul(vsub(fn, into->n), f));
         into->count += 1;
      }
   }
   free(W);
   free(w);
}

/* ------------------------------------------------- inside or outside */
typedef struct block { vec a, c; double area, r; int first, n; } block; /* triangles of one 8 cm cube, far away a dipole */
typedef struct winder { block *block; int blocks, *order; } winder;
static winder build_blocks(const body *b)
{
   winder w = {0};
   double B = 0.08;
   int bx = (int)(b->nx * b->h / B) + 1, by = (int)(b->ny * b->h / B) + 1, bz = (int)(b->nz * b->h / B) + 1, t, k, i, s = 0;
   int *id = NEW(int, bx * by * bz), *of = NEW(int, b->triangles);
   for (i = 0; i < bx * by * bz; i++) id[i] = -1;
   w.block = NEW(block, b->triangles);
   w.order = NEW(int, b->triangles);
   for (t = 0; t < b->triangles; t++) {
      const int *q = b->tri[t];
      vec c = vmul(vadd(vadd(b->pos[q[0]], b->pos[q[1]]), b->pos[q[2]]), 1. / 3), g = vmul(vsub(c, b->org), 1 / B);
      vec A = vmul(vcross(vsub(b->pos[q[1]], b->pos[q[0]]), vsub(b->pos[q[2]], b->pos[q[0]])), .5);
      double a = vlen(A);
      block *k2;
      k = ((int)g.z * by + (int)g.y) * bx + (int)g.x;
      if (id[k] < 0) id[k] = w.blocks++;
      k2 = &w.block[of[t] = id[k]];
      k2->a = vadd(k2->a, A);
      k2->c = vadd(k2->c, vmul(c, a));
      k2->area += a;
      k2->n++;
   }
   for (i = 0; i < w.blocks; i++) { block *k2 = &w.block[i]; k2->first = s; s += k2->n; k2->n = 0; k2->c = vmul(k2->c, 1 / (k2->area + 1e-30)); }
   for (t = 0; t < b->triangles; t++) {
      block *k2 = &w.block[of[t]];
      w.order[k2->first + k2->n++] = t;
      for (k = 0; k < 3; k++) k2->r = fmax(k2->r, vlen(vsub(b->pos[b->tri[t][k]], k2->c)));
   }
   free(id);
   free(of);
   return w;
}
static double winding(const body *b, const winder *w, vec p)
{
   double s = 0;
   int i, k;
   for (i = 0; i < w->blocks; i++) {
      const block *k2 = &w->block[i];
      vec d = vsub(k2->c, p);
      double l = vlen(d);
      if (l > 2.2 * k2->r) { s += vdot(k2->a, d) / (l * l * l); continue; }
      for (k = 0; k < k2->n; k++) { /* the exact solid angle of a triangle (Van Oosterom, Strackee 1983) */
         const int *t = b->tri[w->order[k2->first + k]];
         vec a = vsub(b->pos[t[0]], p), e = vsub(b->pos[t[1]], p), c = vsub(b->pos[t[2]], p);
         double la = vlen(a), lb = vlen(e), lc = vlen(c);
         s += 2 * atan2(vdot(a, vcross(e, c)), la * lb * lc + vdot(a, e) * lc + vdot(e, c) * la + vdot(c, a) * lb);
      }
   }
   return s / (4 * 3.14159265358979323846);
}

/* ------------------------------------------------- gluing */
static const int DX[6] = {1, -1, 0, 0, 0, 0}, DY[6] = {0, 0, 1, -1, 0, 0}, DZ[6] = {0, 0, 0, 0, 1, -1};
static int neighbour(const body *b, int c, int d)
{
   int x = b->cell[c].x + DX[d], y = b->cell[c].y + DY[d], z = b->cell[c].z + DZ[d];
   return x < 0 || y < 0 || z < 0 || x >= b->nx || y >= b->ny || z >= b->nz ? -1 : b->grid[place(b, x, y, z)];
}
static int find(int *u, int i) { while (u[i] != i) i = u[i] = u[u[i]]; return i; }
static int inner_side(const body *b, const cell *s, const cell *c) /* of surface cell s is where interior cell c lies */
{
   return vdot(vsub(flesh_centre(b, c), s->p), s->n) < 0.5 * b->h * vlen(s->n);
}
/* weights of interior cells: the harmonic extension of the surface's */
static void fill_weights(body *b, int surface)
{
   int P = b->parts, sweep, c, d, o, p, n;
   char *set = NEW(char, b->cells);
   float *acc = NEW(float, P);
   memset(set, 1, (size_t)surface);
   for (sweep = 0; sweep < 60; sweep++) for (c = surface; c < b->cells; c++) {
      memset(acc, 0, sizeof *acc * (size_t)P);
      for (n = d = 0; d < 6; d++) for (o = neighbour(b, c, d); o >= 0; o = b->cell[o].next)
         if (set[o] && (o >= surface || inner_side(b, &b->cell[o], &b->cell[c]))) { for (p = 0; p < P; p++) acc[p] += cell_weights(b, o)[p]; n++; }
      if (n) { for (p = 0; p < P; p++) cell_weights(b, c)[p] = acc[p] / (float)n; set[c] = 1; }
   }
   free(set);
   free(acc);
}
static void glue(body *b, int surface)
{
   int C = b->cells, P = b->parts, c, d, k, o, i, p, pass, *u = NEW(int, 8 * C), *id = NEW(int, 8 * C), *count;
   for (i = 0; i < 8 * C; i++) u[i] = i;
   for (c = 0; c < C; c++) for (d = 0; d < 6; d++) b->cell[c].link[d] = -1;
   for (c = 0; c < C; c++) for (d = 0; d < 6; d += 2) for (o = neighbour(b, c, d); o >= 0; o = b->cell[o].next) {
      int axis = d / 2;
      if (apart(b, cell_weights(b, c), cell_weights(b, o)) > 1.0) continue;
      if (c < surface && o >= surface && !inner_side(b, &b->cell[c], &b->cell[o])) continue;
      if (o < surface && c >= surface && !inner_side(b, &b->cell[o], &b->cell[c])) continue;
      for (k = 0; k < 8; k++) if (k >> axis & 1) { int x = find(u, 8 * c + k), y = find(u, 8 * o + (k & ~(1 << axis))); u[x] = y; }
      b->cell[c].link[d] = o;
      b->cell[o].link[d + 1] = c;
   }
   for (i = 0; i < 8 * C; i++) id[i] = -1;
   for (i = 0; i < 8 * C; i++) if (find(u, i) == i) id[i] = b->nodes++;
   b->x = NEW(vec, b->nodes);
   b->nw = NEW(float, (size_t)b->nodes * (size_t)P);
   b->shell = NEW(int, b->nodes);
   count = NEW(int, b->nodes);
   for (c = 0; c < C; c++) for (k = 0; k < 8; k++) {
      int n = b->cell[c].node[k] = id[find(u, 8 * c + k)];
      b->x[n] = vadd(b->org, vmake((b->cell[c].x + (k & 1)) * b->h, (b->cell[c].y + (k >> 1 & 1)) * b->h, (b->cell[c].z + (k >> 2)) * b->h));
      for (p = 0; p < P; p++) b->nw[(size_t)n * (size_t)P + (size_t)p] += cell_weights(b, c)[p];
      count[n]++;
      if (b->cell[c].inside) b->shell[n] = 1;
   }
   for (i = 0; i < b->nodes; i++) {
      for (p = 0; p < P; p++) b->nw[(size_t)i * (size_t)P + (size_t)p] /= (float)count[i];
      b->shell[i] = !b->shell[i];
   }
   for (pass = 0; pass < 2; pass++) { /* the shell recedes two cells from the interior */
      char *close = NEW(char, b->nodes);
      for (c = 0; c < C; c++) {
         int any = 0;
         for (k = 0; k < 8; k++) any |= !b->shell[b->cell[c].node[k]];
         for (k = 0; any && k < 8; k++) close[b->cell[c].node[k]] = 1;
      }
      for (i = 0; i < b->nodes; i++) if (close[i]) b->shell[i] = 0;
      free(close);
   }
   free(u); free(id); free(count);
}
static void embed_vertices(body *b)
{
   int i, k, c, p;
   float *w = NEW(float, b->parts);
   b->vc = NEW(int, b->vertices);
   b->vw = (float(*)[8])NEW(float, 8 * (size_t)b->vertices);
   b->beta = NEW(float, b->vertices);
   for (i = 0; i < b->vertices; i++) {
      vec g = vmul(vsub(b->pos[i], b->org), 1 / b->h);
      double best = 1e9, f[3], end = 0;
      flesh_part_weights(b, i, w);
      b->vc[i] = -1; /* a vertex of no triangle: stays as skinned */
      if (b->adj0[i + 1] > b->adj0[i]) for (c = b->grid[place(b, (int)g.x, (int)g.y, (int)g.z)]; c >= 0; c = b->cell[c].next) {
         double d = apart(b, cell_weights(b, c), w);
         if (d < best) { best = d; b->vc[i] = c; }
      }
      f[0] = g.x - (int)g.x; f[1] = g.y - (int)g.y; f[2] = g.z - (int)g.z;
      for (k = 0; k < 8; k++) b->vw[i][k] = (float)((k & 1 ? f[0] : 1 - f[0]) * (k & 2 ? f[1] : 1 - f[1]) * (k & 4 ? f[2] : 1 - f[2]));
      for (p = 0; p < b->parts; p++) if (b->end[b->part_joint[p]]) end = fmax(end, w[p]);
      b->beta[i] = b->vc[i] < 0 ? 1 : (float)smooth(0.7, 1.0, end);
   }
   free(w);
}
void flesh_lattice(body *b)
{
   winder w;
   int surface, x, y, z, c;
   surface_cells(b);
   surface = b->cells;
   w = build_blocks(b);
   for (z = 1; z < b->nz - 1; z++) for (y = 1; y < b->ny - 1; y++) for (x = 1; x < b->nx - 1; x++) {
      vec p = vadd(b->org, vmake((x + .5) * b->h, (y + .5) * b->h, (z + .5) * b->h));
      if (b->grid[place(b, x, y, z)] < 0 && winding(b, &w, p) > 0.5) { c = new_cell(b, x, y, z); b->cell[c].inside = 1; }
   }
   for (c = 0; c < b->cells; c++) b->cell[c].vol = c >= surface ? 1 : winding(b, &w, flesh_centre(b, &b->cell[c])) > 0.5 ? 0.85 : 0.45;
   free(w.block);
   free(w.order);
   fill_weights(b, surface);
   glue(b, surface);
   embed_vertices(b);
}
