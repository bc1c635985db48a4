/*  golden_kit.h - the cases of golden.c about >>kit: association, even selection, area, smoothing, factor analysis
    used by golden.c only, after its helpers */
#ifndef DN_GOLDEN_KIT_H
#define DN_GOLDEN_KIT_H

/* what mesh.safetensors says beyond weld, edges and normals */
static void run_mesh_kit(const run *r, const mesh *m, const dn_graph *g)
{
   const dn_tensor *points = in(r, "in.association_points"), *chosen = in(r, "in.wanted"), *area_want = in(r, "out.area");
   float area = (float)dn_area(m->rest, m->triangle, m->triangles);
   void *raw;
   compare(r, area_want, "", &area, 1, 1, 1, NULL);
   if (in(r, "out.smoothed")) { /* 40 iterations, factor 0.12 */
      float *p = (float *)need(m->nodes * 3, sizeof *p), *spare = (float *)need(m->nodes * 3, sizeof *spare);
      memcpy(p, m->rest, m->nodes * 3 * sizeof *p);
      dn_smooth(g, p, 40, 0.12f, spare, NULL);
      compare(r, in(r, "out.smoothed"), "", p, m->nodes, 3, 3, NULL);
      free(p);
      free(spare);
   }
   if (chosen && in(r, "out.even_selection")) {
      int32_t *number = ints(chosen);
      size_t wanted = (size_t)(uint32_t)number[0];
      uint32_t *selection = (uint32_t *)need(wanted, sizeof *selection), spacing = 0;
      unsigned c = 0;
      dn_error err;
      void *scratch = block64(dn_even_selection_scratch(m->nodes), &raw);
      if (dn_even_selection(m->rest, m->nodes, dn_area(m->rest, m->triangle, m->triangles), wanted, selection, &c, scratch, &err) != DN_OK)
         line(r, "FAIL", "out.even_selection", "%s", err.info);
      else {
         spacing = c;
         compare_ints(r, in(r, "out.even_selection"), selection, wanted);
         compare_ints(r, in(r, "out.even_c"), &spacing, 1);
      }
      free(raw);
      free(selection);
      free(number);
   }
   if (points && in(r, "out.association")) {
      size_t count = points->count / 3;
      float *p = floats(points);
      uint32_t *nearest = (uint32_t *)need(count, sizeof *nearest);
      dn_associate(m->rest, m->nodes, p, count, nearest, block64(dn_associate_scratch(m->nodes), &raw), NULL);
      compare_ints(r, in(r, "out.association"), nearest, count);
      free(raw);
      free(nearest);
      free(p);
   }
}

/* against 1e-4 of the tensor's largest entry */
static void compare_scaled(const run *r, const char *name, const float *got, size_t count)
{
   const dn_tensor *t = in(r, name);
   float *want;
   double most = 0, worst = 0;
   size_t i;
   if (!t) return;
   mark(r, t);
   if (t->count != count) {
      line(r, "FAIL", name, "the file has %zu numbers, this program %zu", t->count, count);
      return;
   }
   want = floats(t);
   for (i = 0; i < count; i++) {
      double w = (double)want[i], e = (double)got[i] - w;
      if (e < 0) e = -e;
      if (w < 0) w = -w;
      if (w > most) most = w;
      if (!(e <= worst)) worst = e;
   }
   line(r, worst <= 1e-4 * most ? "PASS" : "FAIL", name, "largest error %.2e of the largest entry", worst / most);
   free(want);
}
static void run_factor(const run *r)
{
   const dn_tensor *d = in(r, "in.distances"), *loading = in(r, "out.loading"), *fresh = in(r, "in.new"), *likelihood = in(r, "out.log_likelihood");
   dn_factor_desc q;
   dn_error err;
   void *raw, *scratch;
   size_t scratch_bytes;
   memset(&q, 0, sizeof q);
   q.rows = dim(d, 0);
   q.pairs = dim(d, 1);
   q.factors = loading ? dim(loading, 1) : dim(in(r, "out.projection"), 0);
   q.distances = floats(d);
   q.mean = (float *)need(q.rows, sizeof(float));
   q.loading = (float *)need(q.rows * q.factors, sizeof(float));
   q.noise = (float *)need(q.rows, sizeof(float));
   q.projection = (float *)need(q.factors * q.rows, sizeof(float));
   q.alpha = (float *)need(q.factors * q.pairs, sizeof(float));
   scratch_bytes = dn_factor_scratch(q.rows, q.pairs, q.factors);
   scratch = block64(scratch_bytes, &raw);
   if (dn_factor_fit(&q, scratch, scratch_bytes, &err) != DN_OK) line(r, "FAIL", "out.loading", "%s", err.info);
   else {
      compare(r, in(r, "out.mean"), "", q.mean, q.rows, 1, 1, NULL);
      compare_scaled(r, "out.loading", q.loading, q.rows * q.factors);
      compare_scaled(r, "out.noise", q.noise, q.rows);
      compare_scaled(r, "out.projection", q.projection, q.factors * q.rows);
      compare_scaled(r, "out.factors", q.alpha, q.factors * q.pairs);
      if (likelihood) {
         float value = (float)q.log_likelihood;
         compare(r, likelihood, "", &value, 1, 1, 1, NULL);
      }
      if (fresh && in(r, "out.alpha")) { /* the run-time half with the file's own matrix where it has one, and with ours */
         const dn_tensor *projection = in(r, "out.projection"), *mean = in(r, "out.mean");
         float *x = floats(fresh), *a = (float *)need(q.factors, sizeof *a);
         if (fresh->count == q.rows) {
            dn_factor_project(q.projection, q.mean, x, q.rows, q.factors, a);
            compare_scaled(r, "out.alpha", a, q.factors);
            if (projection && mean && projection->count == q.rows * q.factors && mean->count == q.rows) {
               float *p = floats(projection), *m = floats(mean);
               dn_factor_project(p, m, x, q.rows, q.factors, a);
               compare(r, in(r, "out.alpha"), "(the file's projection)", a, 1, q.factors, q.factors, NULL);
               free(p);
               free(m);
            }
         }
         free(x);
         free(a);
      }
   }
   free((void *)(uintptr_t)q.distances);
   free(q.mean);
   free(q.loading);
   free(q.noise);
   free(q.projection);
   free(q.alpha);
   free(raw);
}
#endif
