/*  golden_blend.h - golden.c's cases of Neural Blend Shapes: MeshCNN's edges and layers, the skeleton's layers, the network
    masks     a blend-shape mask may flip where a weight is within 1e-5 of its bar (networks.md, section 7). Such a node's
              mask is not compared; its displacement and position are, with what they should be under the mask that this
              program found: the file's shapes and coefficients, summed here in double */
enum { MASK_JOINTS = 1024 };
static const double MASK_NEAR = 1e-5;

/* deformnet.parents of the model: S of them, 0 when it has none */
static size_t parents_of(const run *r, int32_t *parents)
{
   const char *s = dn_tensors_meta(r->model->t, "deformnet.parents");
   size_t n = 0;
   while (s && n < MASK_JOINTS) {
      char *end;
      parents[n++] = (int32_t)strtol(s, &end, 10);
      if (end == s) return 0;
      s = *end == ',' ? end + 1 : NULL;
   }
   return n;
}
/* --- layers */
typedef struct edges { dn_edges e; uint32_t *ends, *ring, *first, *at, *skipped; } edges;
static edges edges_of(const mesh *m)
{
   edges a;
   void *raw, *scratch = block64(dn_edges_scratch(m->nodes, m->triangles), &raw);
   a.ends = (uint32_t *)need(6 * m->triangles, 4);
   a.ring = (uint32_t *)need(12 * m->triangles, 4);
   a.first = (uint32_t *)need(m->nodes + 1, 4);
   a.at = (uint32_t *)need(6 * m->triangles, 4);
   a.skipped = (uint32_t *)need(m->triangles, 4);
   dn_edges_build(m->rest, m->triangle, m->triangles, m->nodes, a.ends, a.ring, a.first, a.at, a.skipped, &a.e, scratch);
   free(raw);
   return a;
}
static void edges_free(edges *a)
{
   free(a->ends);
   free(a->ring);
   free(a->first);
   free(a->at);
   free(a->skipped);
}
static void run_meshcnn(const run *r)
{
   const dn_tensor *x = in(r, "in.x"), *v = in(r, "in.vertex"), *w;
   char *prefix = prefix_of(r, "weight");
   mesh m;
   edges a;
   size_t E;
   if (!mesh_of(r, 0, &m)) {
      mesh_free(&m);
      free(prefix);
      return;
   }
   a = edges_of(&m);
   E = a.e.count;
   compare_ints(r, in(r, "out.node_of_vertex"), m.node_of_vertex, m.vertices);
   compare_ints(r, in(r, "out.edges"), a.ends, 2 * E);
   compare_ints(r, in(r, "out.ring"), a.ring, 4 * E); /* none is -1 there, DN_NO_EDGE here: the same bits */
   compare_ints(r, in(r, "out.skipped"), a.skipped, a.e.skipped);
   if (v && dim(v, 0) == m.nodes) {
      size_t width = v->count / m.nodes;
      float *rows = floats(v), *y = (float *)need(E * width, sizeof *y);
      dn_vertex_to_edge(&a.e, rows, width, width, y, width, NULL);
      compare(r, in(r, "out.vertex_to_edge"), "", y, E, width, width, NULL);
      free(rows);
      free(y);
   }
   if (x) {
      w = prefix ? find(r->model, prefix, "weight", "", "") : NULL;
      if (!w || w->rank != 4 || w->shape[3] != 5 || dim(x, 0) != E || dim(x, 1) != w->shape[1])
         line(r, "FAIL", "in.x", "no weight (out,in,1,5) that fits it, or not %zu edges", E);
      else {
         size_t in_width = w->shape[1], out = w->shape[0];
         float *rows = floats(x), *wv = floats(w), *bias = weight(r, prefix, "bias");
         float *y = (float *)need(E * out, sizeof *y), *plain = (float *)need(E * out, sizeof *plain), *means = (float *)need(m.nodes * out, sizeof *means);
         void *raw, *raw2, *memory = block64(dn_meshconv_size(in_width, out), &raw);
         dn_meshconv layer;
         norm n;
         dn_meshconv_pack(&layer, in_width, out, wv, bias, norm_of(r, prefix, &n), activation_of(r, "none"), memory);
         layer.kernel = chosen(layer.kernel);
         dn_meshconv_run(&layer, &a.e, rows, in_width, y, out, block64(dn_meshconv_scratch(&layer, 1), &raw2), NULL);
         compare(r, in(r, "out.y"), "", y, E, out, out, NULL);
         dn_meshconv_ref(&layer, &a.e, rows, in_width, plain, out);
         compare(r, in(r, "out.y"), "(reference)", plain, E, out, out, NULL);
         dn_edge_to_vertex(&a.e, y, out, out, means, out, NULL);
         compare(r, in(r, "out.edge_to_vertex"), "", means, m.nodes, out, out, NULL);
         dn_channel_pool(y, out, E, out, NULL);
         compare(r, in(r, "out.channel_pool"), "", y, E, out, out, NULL);
         norm_free(&n);
         free(rows);
         free(wv);
         free(bias);
         free(y);
         free(plain);
         free(means);
         free(raw);
         free(raw2);
      }
   }
   edges_free(&a);
   mesh_free(&m);
   free(prefix);
}
static void run_skeleton(const run *r)
{
   const dn_tensor *a = in(r, "in.attention"), *x = in(r, "in.x"), *w = NULL;
   char *prefix = prefix_of(r, "weight");
   int32_t parents[MASK_JOINTS];
   size_t S = parents_of(r, parents), E = dim(a, 0), width = dim(x, 1);
   float *attention, *rows, *pooled_rows;
   if (prefix) w = find(r->model, prefix, "weight", "", "");
   if (!x || a->rank != 2 || x->rank != 2 || x->shape[0] != E) {
      line(r, "FAIL", "in.attention", "no in.x with as many rows");
      free(prefix);
      return;
   }
   attention = floats(a), rows = floats(x);
   pooled_rows = (float *)need(a->shape[1] * width, sizeof *pooled_rows);
   dn_skinning_pool(attention, a->shape[1], rows, width, E, width, pooled_rows, NULL);
   compare(r, in(r, "out.skinning_pool"), "", pooled_rows, a->shape[1], width, width, NULL);
   if (!w || w->rank != 2 || S != a->shape[1] || w->shape[1] != S * width || w->shape[0] % S)
      line(r, "FAIL", "out.y", "no weight (J out, J %zu) with deformnet.parents of %zu joints", width, a->shape[1]);
   else {
      size_t out = w->shape[0] / S;
      float *wv = floats(w), *bias = weight(r, prefix, "bias"), *y = (float *)need(S * out, sizeof *y);
      dn_activation act = activation_of(r, "none");
      dn_skeleton_linear layer;
      void *raw, *memory = block64(dn_skeleton_linear_size(parents, S, width, out), &raw);
      dn_skeleton_linear_pack(&layer, parents, S, width, out, wv, bias, act, memory);
      dn_skeleton_linear_run(&layer, pooled_rows, y, NULL);
      compare(r, in(r, "out.y"), "", y, 1, S * out, S * out, NULL);
      dn_skeleton_linear_ref(parents, S, width, out, wv, bias, act, pooled_rows, y);
      compare(r, in(r, "out.y"), "(reference)", y, 1, S * out, S * out, NULL);
      free(wv);
      free(bias);
      free(y);
      free(raw);
   }
   free(attention);
   free(rows);
   free(pooled_rows);
   free(prefix);
}

/* --- the network */
typedef struct masks { unsigned char *near_bar; /* (V,S-1) */ unsigned char *row; /* (V) any of them */ float *mine; /* (V,S-1) */ } masks;
static masks masks_of(const dn_blend_view *v, size_t rows, const uint32_t *node)
{
   size_t i, j, k, S = v->joints;
   masks m;
   m.near_bar = (unsigned char *)need(rows * S, 1);
   m.row = (unsigned char *)need(rows, 1);
   m.mine = (float *)need(rows * S, sizeof *m.mine);
   for (i = 0; i < rows; i++) {
      size_t n = node ? node[i] : i;
      const float *w = v->skin_weight + n * S;
      for (k = v->mask_first[n]; k < v->mask_first[n + 1]; k++) m.mine[i * (S - 1) + v->mask_joint[k] - 1] = 1;
      for (j = 1; j < S; j++) {
         double bar = j == 20 || j == 21 ? 0.02 : 0.05, a = (double)w[j] - bar, b = (double)w[v->parents[j]] - bar;
         if ((a < MASK_NEAR && a > -MASK_NEAR) || (b < MASK_NEAR && b > -MASK_NEAR)) m.near_bar[i * (S - 1) + j - 1] = m.row[i] = 1;
      }
   }
   return m;
}
/* what the file's displacement (and position) of a row near a bar would be under this program's mask, put over want */
static size_t mend(const run *r, const dn_blend_view *v, const masks *m, size_t pose, size_t row, const float *palette, float *displacement, float *posed)
{
   const dn_tensor *c = in(r, "out.coefficients"), *b = in(r, "out.blend_shapes"), *k = in(r, "out.mask"), *w = in(r, "out.skin_weights");
   size_t S = v->joints, B = v->shapes, i, j, s;
   double d[3] = {0, 0, 0};
   float *alpha, *shape, *mask, *weights;
   if (!c || !b || !k || !w) return 0;
   alpha = (float *)need((S - 1) * B, 4), shape = (float *)need(3 * B, 4), mask = (float *)need(S, 4), weights = (float *)need(S, 4);
   dn_tensor_floats(c, pose * (S - 1) * B, (S - 1) * B, alpha);
   dn_tensor_floats(b, row * 3 * B, 3 * B, shape);
   dn_tensor_floats(k, row * (S - 1), S - 1, mask);
   dn_tensor_floats(w, row * S, S, weights);
   for (j = 0; j + 1 < S; j++) {
      double change = (double)m->mine[row * (S - 1) + j] - (double)mask[j];
      if (change < 0 || change > 0)
         for (i = 0; i < B; i++)
            for (s = 0; s < 3; s++) d[s] += change * (double)alpha[j * B + i] * (double)shape[3 * i + s];
   }
   for (s = 0; s < 3; s++) {
      if (displacement) displacement[s] = (float)((double)displacement[s] + d[s]);
      if (posed) { /* the blended matrix turns the change */
         double turned = 0;
         for (j = 0; j < S; j++)
            for (i = 0; i < 3; i++) turned += (double)weights[j] * (double)palette[12 * j + 4 * s + i] * d[i];
         posed[s] = (float)((double)posed[s] + turned);
      }
   }
   free(alpha);
   free(shape);
   free(mask);
   free(weights);
   return 1;
}
/* rows near a bar that disagree with the file, against the mended ones */
static void check_mended(const run *r, const dn_blend_view *v, const masks *m, const char *name, const float *got, size_t poses, size_t rows,
                         const float *palettes, int is_posed)
{
   const dn_tensor *t = in(r, name);
   size_t p, i, mended = 0, bad = 0;
   float *want;
   if (!t || t->count != poses * rows * 3) return;
   want = floats(t);
   for (p = 0; p < poses; p++)
      for (i = 0; i < rows; i++) {
         float *to = want + 3 * (p * rows + i);
         const float *mine = got + 3 * (p * rows + i);
         if (!m->row[i] || row_agrees(to, mine, 3)) continue;
         mended++;
         if (!mend(r, v, m, p, i, palettes + 12 * v->joints * p, is_posed ? NULL : to, is_posed ? to : NULL) || !row_agrees(to, mine, 3)) bad++;
      }
   if (mended)
      line(r, bad ? "FAIL" : "PASS", is_posed ? "out.posed (other mask)" : "out.displacement (other mask)", "%zu rows whose weight is within 1e-5 of a mask's bar, %zu not as this mask would have them", mended, bad);
   free(want);
}
static void run_blend(const run *r)
{
   const dn_tensor *p = in(r, "in.positions"), *f = in(r, "in.faces"), *turns = in(r, "in.axis_angle"), *full = in(r, "in.rotations"), *t;
   dn_error err;
   dn_model *model = dn_model_load(r->model->b.data, r->model->b.size, &options, NULL, &err);
   dn_blend *blend = NULL;
   dn_blend_desc d;
   dn_blend_view v;
   dn_probe probe;
   taps seen;
   tapped *k;
   mesh m;
   memset(&m, 0, sizeof m);
   memset(&seen, 0, sizeof seen);
   memset(&d, 0, sizeof d);
   if (!model) line(r, "FAIL", "model", "%s: %s", err.where, err.info);
   if (model && p && mesh_of(r, 0, &m)) {
      probe = probe_of(&seen, r, NULL);
      d.mesh.vertices = m.vertices, d.mesh.positions = m.positions;
      d.mesh.triangles = m.triangles, d.mesh.indices = m.faces, d.mesh.index_type = DN_U32;
      if (in(r, "in.tolerance")) dn_tensor_floats(in(r, "in.tolerance"), 0, 1, &d.weld_distance);
      d.probe = &probe;
      blend = dn_blend_create(model, &d, NULL, &err);
      if (!blend) line(r, "FAIL", "dn_blend_create", "%s: %s", err.where, err.info);
   } else if (model) line(r, "FAIL", "in.positions", "no mesh");
   (void)f;
   if (blend) {
      size_t S, B, poses, rows, i, s, q, count = dn_tensors_count(r->cases->t);
      const uint32_t *node;
      float *rotations, *alpha, *delta, *posed, *palettes, *per_row, *displaced;
      unsigned char *near_row;
      masks mask;
      void *scratch;
      size_t scratch_bytes;
      dn_blend_describe(blend, &v);
      S = v.joints, B = v.shapes;
      for (i = 0; i < count; i++) { /* in the file's order */
         char *prefix = joined("golden.", r->name, *r->name ? "." : "", "mid.");
         t = dn_tensors_at(r->cases->t, i);
         if (strncmp(t->name, prefix, strlen(prefix)) == 0 && (k = tapped_rows(&seen, t->name + strlen(prefix))) != NULL)
            compare(r, t, "", k->rows, k->count, k->width, k->width, NULL);
         free(prefix);
      }
      compare_ints(r, in(r, "out.node_of_vertex"), v.node_of_vertex, v.vertices);
      compare_ints(r, in(r, "out.first_vertex"), v.first_vertex, v.nodes);
      /* per vertex, or per node where that is what the file has */
      t = in(r, "out.skin_weights");
      if (!t) t = in(r, "out.posed");
      rows = t && (t->rank == 3 ? t->shape[1] : dim(t, 0)) == v.nodes ? v.nodes : v.vertices;
      node = rows == v.vertices ? v.node_of_vertex : NULL;
      per_row = (float *)need(rows * (S + 3 * B), sizeof *per_row);
      for (i = 0; i < rows; i++) memcpy(per_row + i * S, v.skin_weight + (node ? node[i] : i) * S, S * sizeof *per_row);
      compare(r, in(r, "out.skin_weights"), "", per_row, rows, S, S, NULL);
      compare(r, in(r, "out.joint_offsets"), "", v.joint_offset, S, 3, 3, NULL);
      for (i = 0; i < rows; i++) memcpy(per_row + i * 3 * B, v.shape + (node ? node[i] : i) * 3 * B, 3 * B * sizeof *per_row);
      compare(r, in(r, "out.blend_shapes"), "", per_row, rows, 3 * B, 3 * B, NULL);
      mask = masks_of(&v, rows, node);
      compare(r, in(r, "out.mask"), "", mask.mine, rows * (S - 1), 1, 1, mask.near_bar);
      /* poses */
      poses = full ? full->count / (9 * S) : turns ? turns->count / (3 * S) : 0;
      rotations = (float *)need(poses * S * 9, sizeof *rotations);
      if (full) dn_tensor_floats(full, 0, poses * S * 9, rotations);
      else if (poses) {
         float *a = floats(turns);
         for (s = 0; s < poses * S; s++) dn_rodrigues(a + 3 * s, rotations + 9 * s);
         free(a);
      }
      scratch = dn_blend_scratch_create(blend, NULL, &scratch_bytes, &err);
      alpha = (float *)need(poses * S * B, sizeof *alpha);
      delta = (float *)need(poses * v.vertices * 3, sizeof *delta);
      posed = (float *)need(poses * v.vertices * 3, sizeof *posed);
      displaced = (float *)need(v.vertices * 3, sizeof *displaced);
      palettes = (float *)need(poses * S * 12, sizeof *palettes);
      near_row = (unsigned char *)need(poses * rows, 1);
      for (q = 0; q < poses; q++) {
         dn_blend_input pose;
         dn_blend_output out;
         memset(&pose, 0, sizeof pose);
         memset(&out, 0, sizeof out);
         pose.rotations = rotations + q * S * 9, pose.strength = 1;
         out.displacement = delta + q * v.vertices * 3, out.positions = posed + q * v.vertices * 3, out.palette = palettes + q * S * 12;
         out.coefficients = alpha + q * (S - 1) * B;
         if (dn_blend_pose(blend, &pose, &out, scratch, scratch_bytes, NULL, &err) != DN_OK) line(r, "FAIL", "dn_blend_pose", "%s", err.info);
         dn_blend_displace(blend, out.coefficients, displaced, 0, NULL);
         if (memcmp(displaced, out.displacement, v.vertices * 12) != 0) line(r, "FAIL", "dn_blend_displace", "not what dn_blend_pose adds");
         for (i = 0; i < rows; i++) {
            near_row[q * rows + i] = mask.row[i];
            if (node) continue;
            memmove(delta + 3 * (q * rows + i), delta + 3 * (q * v.vertices + v.first_vertex[i]), 12);
            memmove(posed + 3 * (q * rows + i), posed + 3 * (q * v.vertices + v.first_vertex[i]), 12);
         }
      }
      compare(r, in(r, "out.coefficients"), "", alpha, poses, (S - 1) * B, (S - 1) * B, NULL);
      compare(r, in(r, "out.displacement"), "", delta, poses * rows, 3, 3, near_row);
      compare(r, in(r, "out.posed"), "", posed, poses * rows, 3, 3, near_row);
      check_mended(r, &v, &mask, "out.displacement", delta, poses, rows, palettes, 0);
      check_mended(r, &v, &mask, "out.posed", posed, poses, rows, palettes, 1);
      dn_scratch_free(scratch, scratch_bytes, NULL);
      free(per_row);
      free(rotations);
      free(alpha);
      free(delta);
      free(posed);
      free(displaced);
      free(palettes);
      free(near_row);
      free(mask.near_bar);
      free(mask.row);
      free(mask.mine);
   }
   dn_blend_free(blend);
   dn_model_free(model);
   taps_free(&seen);
   mesh_free(&m);
}
static int run_blend_case(const run *r, const char *arch) /* 0: not one of these */
{
   if (arch ? strcmp(arch, "neuralblendshapes") == 0 : in(r, "in.axis_angle") != NULL && in(r, "in.faces") != NULL && in(r, "out.blend_shapes") != NULL) run_blend(r);
   else if (!arch && in(r, "in.attention")) run_skeleton(r);
   else if (!arch && in(r, "in.positions") && in(r, "in.faces") && (in(r, "out.ring") || in(r, "in.vertex") || in(r, "out.skipped"))) run_meshcnn(r);
   else return 0;
   return 1;
}
