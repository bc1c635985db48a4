/* golden_garment.h - garments' networks and the output decomposition. Part of golden.c, which alone includes it.
   Inputs of a case: in.garment_positions, in.garment_faces, in.body_positions, in.body_faces, in.body_skin_indices,
   in.body_skin_weights, in.joints, in.palettes, in.alpha, in.beta, in.theta; in.coarse_displacement per pose and
   in.coarse_displacement_rest where the model is only the refining one. */

static int is_garment(const char *arch)
{
   return strcmp(arch, "garfit_coarse") == 0 || strcmp(arch, "garfitnet") == 0 || strcmp(arch, "clothnet") == 0;
}
static void run_decompose(const run *r)
{
   const dn_tensor *d = in(r, "in.direction"), *l = in(r, "in.length");
   size_t count = l->count;
   float *direction, *length, *y;
   if (d->count != 3 * count) {
      line(r, "FAIL", "in.direction", "%zu numbers, expected three for each of %zu lengths", d->count, count);
      return;
   }
   direction = floats(d), length = floats(l);
   y = (float *)need(d->count, sizeof *y);
   dn_decompose(direction, length, count, y);
   compare(r, in(r, "out.y"), "", y, count, 3, 3, NULL);
   dn_decompose(direction, length, count, direction);
   compare(r, in(r, "out.y"), "(in place)", direction, count, 3, 3, NULL);
   free(direction);
   free(length);
   free(y);
}

/* what a garment network's pools stand between, and which rows tell where its directions are short */
typedef struct outfit { const char *arch; pooling pools[2]; const char *also[5] /* the last one NULL */, *coarse_out, *refine_out; } outfit;
static const outfit outfits[] = {
   {"garfit_coarse", {{NULL, NULL, {NULL, NULL}, NULL}, {NULL, NULL, {NULL, NULL}, NULL}}, {"dir.out", NULL, NULL, NULL, NULL}, "dir.out", NULL},
   {"garfitnet",
    {{"dir.", "hadamard", {"global.0", "global.1"}, "global.2"}, {"len.", "hadamard", {"global.0", "global.1"}, "global.2"}},
    {"dir.out", "hadamard", NULL, NULL, NULL}, NULL, "dir.out"},
   {"clothnet",
    {{"detail.dir.", "detail.dir.gat.0", {"gat.1", "gat.2"}, "gat.3"}, {"detail.len.", "detail.len.gat.0", {"gat.1", "gat.2"}, "gat.3"}},
    {"coarse.dir.out", "detail.dir.out", "detail.dir.gat.0", "detail.len.gat.0", NULL}, "coarse.dir.out", "detail.dir.out"}};

typedef struct suit {
   const outfit *kind;
   dn_model *model;
   dn_model_info info;
   dn_garment *garment;
   dn_garment_view view;
   void *raw, *scratch;
   size_t scratch_bytes, joints, poses;
   float *palettes, *theta, *coarse, *coarse_rest; /* (poses,S,12), (poses,T), (poses,N,3) or NULL, (N,3) or NULL */
} suit;
static void suit_free(suit *s)
{
   free(s->raw);
   free(s->palettes);
   free(s->theta);
   free(s->coarse);
   free(s->coarse_rest);
   dn_garment_free(s->garment);
   dn_model_free(s->model);
}
static int suit_of(const run *r, const outfit *kind, bytes file_bytes, suit *s)
{
   const dn_tensor *gp = in(r, "in.garment_positions"), *gf = in(r, "in.garment_faces"), *bp = in(r, "in.body_positions");
   const dn_tensor *bf = in(r, "in.body_faces"), *ji = in(r, "in.body_skin_indices"), *jw = in(r, "in.body_skin_weights");
   const dn_tensor *joints = in(r, "in.joints"), *palettes = in(r, "in.palettes"), *alpha = in(r, "in.alpha"), *beta = in(r, "in.beta");
   const dn_tensor *theta = in(r, "in.theta"), *coarse = in(r, "in.coarse_displacement"), *rest = in(r, "in.coarse_displacement_rest");
   const dn_tensor *tolerance = in(r, "in.tolerance");
   float *garment_positions, *body_positions, *weights, *inverse, *a = NULL, *b = NULL, *at = NULL;
   uint32_t *garment_faces = NULL, *body_faces = NULL, *index;
   dn_skin_set skin;
   dn_garment_desc d;
   dn_error err;
   size_t i;
   memset(s, 0, sizeof *s);
   memset(&d, 0, sizeof d);
   memset(&skin, 0, sizeof skin);
   if (!gp || !bp || !ji || !jw || !palettes || ji->count != jw->count || palettes->rank < 2 || ji->rank != 2 || ji->shape[0] != bp->count / 3) {
      line(r, "FAIL", "in", "garment_positions, body_positions, body_skin_indices, body_skin_weights and palettes are needed");
      return 0;
   }
   s->kind = kind;
   s->joints = palettes->rank >= 4 ? palettes->shape[1] : palettes->count / 12;
   s->poses = s->joints ? palettes->count / 12 / s->joints : 0;
   s->palettes = floats(palettes);
   s->model = dn_model_load(file_bytes.data, file_bytes.size, &options, NULL, &err);
   if (!s->model) {
      line(r, "FAIL", "model", "%s: %s", dn_result_text(err.code), err.info);
      return 0;
   }
   dn_model_describe(s->model, &s->info);
   if (s->info.joint_names && s->info.joints != s->joints) {
      line(r, "FAIL", "in.palettes", "%zu joints, the model names %zu", s->joints, s->info.joints);
      return 0;
   }
   garment_positions = floats(gp), body_positions = floats(bp), weights = floats(jw), index = indices(ji);
   if (gf) garment_faces = indices(gf);
   if (bf) body_faces = indices(bf);
   if (alpha) a = floats(alpha), d.alpha = a, d.alphas = alpha->count;
   if (beta) b = floats(beta), d.beta = b, d.betas = beta->count;
   if (theta && s->poses) s->theta = floats(theta), d.thetas = theta->count / s->poses;
   if (coarse) s->coarse = floats(coarse);
   if (rest) s->coarse_rest = floats(rest), d.coarse_rest = s->coarse_rest, d.coarse_rest_nodes = rest->count / 3;
   inverse = (float *)need(s->joints * 12, sizeof *inverse);
   if (joints && joints->count == 3 * s->joints) at = floats(joints);
   for (i = 0; i < s->joints; i++) { /* joints rest unrotated: the inverse bind moves each to the origin */
      float *m = inverse + 12 * i;
      m[0] = m[5] = m[10] = 1;
      if (at) m[3] = -at[3 * i], m[7] = -at[3 * i + 1], m[11] = -at[3 * i + 2];
   }
   skin.influences = ji->shape[1];
   skin.joints = index, skin.joint_type = DN_U32;
   skin.weights = weights, skin.weight_type = DN_F32;
   d.body.vertices = bp->count / 3, d.body.positions = body_positions;
   d.body.triangles = bf ? bf->count / 3 : 0, d.body.indices = body_faces, d.body.index_type = DN_U32;
   d.body.skin_sets = 1, d.body.skin = &skin;
   d.skeleton.joints = s->joints, d.skeleton.names = s->info.joint_names;
   d.skeleton.inverse_bind = inverse, d.skeleton.matrix = DN_3X4_ROWS;
   d.garment.vertices = gp->count / 3, d.garment.positions = garment_positions;
   d.garment.triangles = gf ? gf->count / 3 : 0, d.garment.indices = garment_faces, d.garment.index_type = DN_U32;
   if (kind->coarse_out) d.coarse = s->model;
   if (kind->refine_out) d.refine = s->model;
   if (tolerance) dn_tensor_floats(tolerance, 0, 1, &d.weld_distance);
   s->garment = dn_garment_create(&d, NULL, NULL, &err);
   if (!s->garment) line(r, "FAIL", err.where, "%s: %s", dn_result_text(err.code), err.info);
   free(garment_positions);
   free(body_positions);
   free(weights);
   free(index);
   free(garment_faces);
   free(body_faces);
   free(a);
   free(b);
   free(at);
   free(inverse);
   if (!s->garment) return 0;
   dn_garment_describe(s->garment, &s->view);
   if (s->coarse && coarse->count != 3 * s->poses * s->view.nodes) {
      line(r, "FAIL", "in.coarse_displacement", "%zu numbers, expected %zu x %zu x 3", coarse->count, s->poses, s->view.nodes);
      return 0;
   }
   s->scratch_bytes = dn_garment_scratch_size(s->garment, 1);
   s->scratch = block64(s->scratch_bytes, &s->raw);
   return 1;
}
/* one pose, or the rest pose when q is SIZE_MAX; the coarse and the refining stage, and what came out for the vertices.
   coarse (poses,N,3) or NULL: in place of the coarse stage */
static int suit_run(const run *r, suit *s, size_t q, const float *coarse, const dn_probe *probe, float *positions, float *displacement)
{
   float *identity = NULL;
   dn_garment_pose pose;
   dn_garment_output out;
   dn_error err;
   size_t i;
   dn_result code;
   memset(&pose, 0, sizeof pose);
   memset(&out, 0, sizeof out);
   pose.strength = 1;
   if (q == SIZE_MAX) {
      identity = (float *)need(s->joints * 12, sizeof *identity);
      for (i = 0; i < s->joints; i++) identity[12 * i] = identity[12 * i + 5] = identity[12 * i + 10] = 1;
      pose.palette = identity;
      pose.coarse_displacement = s->coarse_rest;
   } else {
      pose.palette = s->palettes + q * s->joints * 12;
      if (s->theta) pose.theta = s->theta + q * s->view.thetas;
      if (s->coarse) pose.coarse_displacement = s->coarse + q * s->view.nodes * 3;
      if (coarse) pose.coarse_displacement = coarse + q * s->view.nodes * 3;
   }
   out.positions = positions, out.displacement = displacement;
   code = dn_garment_stage_follow(s->garment, &pose, s->scratch, s->scratch_bytes, NULL, &err);
   if (code == DN_OK) {
      dn_garment_stage_coarse(s->garment, &pose, s->scratch, NULL, probe);
      dn_garment_stage_refine(s->garment, &pose, s->scratch, NULL, probe);
      code = dn_garment_stage_output(s->garment, &pose, &out, s->scratch, NULL, &err);
   }
   if (code != DN_OK) line(r, "FAIL", err.where, "%s: %s", dn_result_text(code), err.info);
   free(identity);
   return code == DN_OK;
}
/* nodes whose direction is too short to be told (networks.md, section 7) */
static size_t short_directions(const taps *t, const char *name, size_t nodes, unsigned char *flag)
{
   const tapped *x = name ? tapped_rows(t, name) : NULL;
   size_t i, k, n = 0;
   for (i = 0; x && x->width == 3 && x->count == nodes && i < nodes; i++) {
      double size = 0;
      for (k = 0; k < 3; k++) {
         double g = tanh((double)x->rows[3 * i + k]);
         size += g * g;
      }
      if (!(size >= 0.01 * 0.01)) n += flag[i] = 1;
   }
   return n;
}
/* nodes of the refining stage that an uncertain coarse node may reach: normals, five or six blocks, three of them among clusters */
static void spread_out(const dn_graph *g, unsigned char *reach)
{
   int i;
   for (i = 0; i < 12; i++) widen(g, NULL, 0, reach);
}

/* --- a block by itself, on the file's own input (see alone in golden.c). The input of each block, as names of other
   blocks in the order of its columns; * stands for the block's own prefix. */
static const struct { const char *arch, *prefix, *block, *input[8]; } wiring[] = {
   {"garfit_coarse", "", "gat.0", {"features"}}, {"garfit_coarse", "", "gat.1", {"gat.0"}},
   {"garfit_coarse", "", "gat.2", {"gat.1"}},    {"garfit_coarse", "", "gat.3", {"gat.2"}},
   {"garfit_coarse", "dl", "out", {"gat.3"}},
   {"garfitnet", "", "gat.0", {"features"}},     {"garfitnet", "", "gat.1", {"gat.0"}},
   {"garfitnet", "", "fit.1", {"fit.0"}},        {"garfitnet", "", "fit.2", {"fit.1"}},
   {"garfitnet", "", "hadamard", {"gat.1", "gat.0"}},
   {"garfitnet", "dl", "local.0", {"hadamard"}}, {"garfitnet", "dl", "local.1", {"*local.0", "hadamard"}},
   {"garfitnet", "dl", "local.2", {"*local.1", "*local.0", "hadamard"}},
   {"garfitnet", "dl", "local.3", {"*local.2", "*local.1", "*local.0", "hadamard"}},
   {"garfitnet", "dl", "pool", {"hadamard"}},    {"garfitnet", "dl", "global.0", {"*pool"}},
   {"garfitnet", "dl", "global.1", {"*global.0"}}, {"garfitnet", "dl", "unpool", {"*global.1"}},
   {"garfitnet", "dl", "global.2", {"*unpool"}},
   {"garfitnet", "dl", "post.0", {"*local.3", "*local.2", "*local.1", "*local.0", "hadamard", "*global.2"}},
   {"garfitnet", "dl", "post.1", {"*post.0"}},   {"garfitnet", "dl", "out", {"*post.1"}},
   {"clothnet", "coarse.", "gat", {"coarse.features"}},
   {"clothnet", "coarse.dl", "gat.0", {"coarse.gat"}}, {"clothnet", "coarse.dl", "gat.1", {"*gat.0"}},
   {"clothnet", "coarse.dl", "gat.2", {"*gat.1"}},     {"clothnet", "coarse.dl", "post.0", {"*gat.2"}},
   {"clothnet", "coarse.dl", "post.1", {"*post.0"}},   {"clothnet", "coarse.dl", "out", {"*post.1"}},
   {"clothnet", "detail.", "gat", {"detail.features"}},
   {"clothnet", "", "parser.1", {"parser.0"}},         {"clothnet", "", "parser.2", {"parser.1"}},
   {"clothnet", "", "hadamard", {"detail.gat"}},
   {"clothnet", "detail.dl", "gat.0", {"hadamard"}},   {"clothnet", "detail.dl", "pool", {"*gat.0"}},
   {"clothnet", "detail.dl", "gat.1", {"*pool"}},      {"clothnet", "detail.dl", "gat.2", {"*gat.1"}},
   {"clothnet", "detail.dl", "unpool", {"*gat.2"}},    {"clothnet", "detail.dl", "gat.3", {"*unpool"}},
   {"clothnet", "detail.dl", "post.0", {"*gat.3"}},    {"clothnet", "detail.dl", "post.1", {"*post.0"}},
   {"clothnet", "detail.dl", "out", {"*post.1"}}};

static float *from_file(const run *r, const char *prefix, const char *name, size_t *count, size_t *width) /* a mid tensor, or NULL */
{
   char *full = *name == '*' ? joined("mid.", prefix, name + 1, "") : joined("mid.", name, "", "");
   const dn_tensor *t = in(r, full);
   free(full);
   if (!t || t->rank != 2) return NULL;
   *count = t->shape[0], *width = t->shape[1];
   return floats(t);
}
/* the file's contraction at prefix.pool; its graph and arrays are to be freed with contraction_free */
typedef struct contraction { dn_clusters c; graph g; } contraction;
static void contraction_free(contraction *k)
{
   clusters_free(&k->c);
   graph_free(&k->g);
}
static int contraction_of(const run *r, const char *prefix, const dn_graph *g, contraction *k)
{
   char *members = joined("mid.", prefix, "pool.members", ""), *score = joined("mid.", prefix, "pool.score", "");
   const dn_tensor *m = in(r, members), *s = in(r, score);
   uint32_t *triangle;
   int32_t *pairs;
   size_t i, e, n = 0, bad = 0, count;
   free(members);
   free(score);
   if (!m || !s || m->count != 2 * s->count || s->count > g->nodes) return 0;
   count = s->count;
   k->c = clusters_for(g);
   pairs = ints(m);
   for (i = 0; i < 2 * count; i++)
      if (pairs[i] < 0 || (size_t)pairs[i] >= g->nodes) bad++;
      else k->c.members[i] = (uint32_t)pairs[i], k->c.cluster[pairs[i]] = (uint32_t)(i / 2);
   free(pairs);
   dn_tensor_floats(s, 0, count, k->c.score);
   triangle = (uint32_t *)need(3 * (size_t)g->first[g->nodes], sizeof *triangle);
   for (i = 0; i < g->nodes; i++)
      for (e = g->first[i]; e < g->first[i + 1]; e++, n++) triangle[3 * n] = k->c.cluster[i], triangle[3 * n + 1] = triangle[3 * n + 2] = k->c.cluster[g->next[e]];
   k->g = graph_of_triangles(triangle, n, count);
   free(triangle);
   k->c.count = count, k->c.graph = k->g.g;
   if (bad) contraction_free(k);
   return !bad;
}
typedef struct workshop { const run *r; suit *s; const float *features; } workshop;
static float *block_alone(const alone *a, const char *name, size_t count, size_t width)
{
   const workshop *w = (const workshop *)a->user;
   const run *r = w->r;
   const suit *s = w->s;
   const dn_graph *g = &s->view.graph;
   const dn_model *m = s->model;
   size_t at, k, i, total = 0, rows = 0;
   float *parts[8], *x = NULL, *y = NULL, *code;
   size_t widths[8];
   char prefix[32] = "";
   const char *block = NULL;
   if (w->features && strcmp(name, "detail.features") == 0) { /* from the file's coarse displacement */
      y = (float *)need(count * width, sizeof *y);
      memcpy(y, w->features, count * width * sizeof *y);
      return y;
   }
   for (at = 0; at < COUNT(wiring) && !block; at++) { /* which entry is this? dl stands for dir. and len. */
      for (k = 0; k < 2 && !block; k++) {
         const char *p = wiring[at].prefix;
         size_t n = strlen(p);
         int heads = n >= 2 && strcmp(p + n - 2, "dl") == 0;
         if (strcmp(wiring[at].arch, s->kind->arch) != 0) break;
         sprintf(prefix, "%.*s%s", (int)(heads ? n - 2 : n), p, heads ? k ? "len." : "dir." : "");
         if (strncmp(name, prefix, strlen(prefix)) == 0 && strcmp(name + strlen(prefix), wiring[at].block) == 0) block = wiring[at].block;
      }
   }
   if (!block) return NULL;
   at--;
   for (k = 0; k < COUNT(parts) && wiring[at].input[k]; k++) {
      parts[k] = from_file(r, prefix, wiring[at].input[k], &i, &widths[k]);
      if (!parts[k] || (k && i != rows)) {
         while (k-- > 0) free(parts[k]);
         return NULL;
      }
      rows = i;
      total += widths[k];
   }
   x = (float *)need(rows * total, sizeof *x);
   {
      size_t parts_count = k, column = 0;
      for (k = 0; k < parts_count; k++) {
         for (i = 0; i < rows; i++) memcpy(x + i * total + column, parts[k] + i * widths[k], widths[k] * sizeof *x);
         column += widths[k];
         free(parts[k]);
      }
   }
   if (strstr(wiring[at].input[0], "features")) {
      const dn__stage *stage = &m->stage[strncmp(name, "detail.", 7) == 0];
      if (stage->row_width == total) dn__normalise(stage, m->info.kernel, x, rows, NULL);
   }
   y = (float *)need(count * width, sizeof *y);
   if (strcmp(block, "hadamard") == 0) {
      code = from_file(r, "", strcmp(s->kind->arch, "clothnet") == 0 ? "parser.2" : "fit.2", &i, &k);
      if (code && k == total && total == width && rows == count)
         for (i = 0; i < count * width; i++) y[i] = x[i] * code[i % width];
      else free(y), y = NULL;
      free(code);
   } else if (strcmp(block, "pool") == 0 || strcmp(block, "unpool") == 0) {
      const dn_pool *by = &m->branch[strstr(prefix, "len.") != NULL].pool;
      contraction c;
      if (!contraction_of(r, prefix, g, &c)) free(y), y = NULL;
      else {
         if (strcmp(block, "pool") == 0 && rows == g->nodes && total == width && by->in == width && count == c.c.count) {
            dn_pool_rescore(by, g, x, total, &c.c, NULL);
            dn_pool_gather(by, &c.c, x, total, width, y, width, NULL);
         } else if (strcmp(block, "unpool") == 0 && rows == c.c.count && total == width && count == g->nodes)
            dn_pool_scatter(by, &c.c, x, total, width, count, y, width, NULL);
         else free(y), y = NULL;
         contraction_free(&c);
      }
   } else { /* a layer of the model */
      const dn__block *b = NULL;
      contraction c;
      int coarse = strcmp(wiring[at].input[0], "*pool") == 0 || strcmp(block, "global.1") == 0 ||
                   (strcmp(block, "gat.2") == 0 && strncmp(name, "detail.", 7) == 0);
      for (i = 0; i < m->block_count && !b; i++)
         if (strcmp(m->blocks[i].name, name) == 0) b = &m->blocks[i];
      if (!b || b->in != total || b->out != width || rows != count || (coarse && !contraction_of(r, prefix, g, &c))) free(y), y = NULL;
      else {
         if (b->kind == DN__LINEAR) dn_linear_run(&b->linear, x, total, rows, y, width, NULL);
         else if (rows == (coarse ? c.c.count : g->nodes)) {
            void *raw, *scratch = block64(dn_gat_scratch(&b->gat, rows), &raw);
            dn_gat_run(&b->gat, coarse ? &c.c.graph : g, x, total, y, width, scratch, NULL);
            free(raw);
         } else free(y), y = NULL;
         if (coarse) contraction_free(&c);
      }
   }
   free(x);
   return y;
}

static size_t rows_off(const dn_tensor *t, const float *got, const unsigned char *excused) /* rows of three that disagree */
{
   float *want = floats(t);
   size_t i, bad = 0;
   for (i = 0; i < t->count / 3; i++) bad += !(excused && excused[i]) && !row_agrees(want + 3 * i, got + 3 * i, 3);
   free(want);
   return bad;
}
/* clothnet: the coarse displacement that the file tells for this frame, (poses,N,3), or NULL */
static float *coarse_of_file(const run *r, const suit *s, const char *frame)
{
   const dn_tensor *t = in(r, frame && strcmp(frame, "root") == 0 ? "out.coarse_displacement_root_frame" : "out.coarse_displacement");
   return t && strcmp(s->kind->arch, "clothnet") == 0 && t->count == 3 * s->poses * s->view.nodes ? floats(t) : NULL;
}
static void run_garment(const run *r, const char *arch)
{
   static const struct { const char *suffix, *pooling, *frame; } variants[] = {
      {"", "dynamic", NULL}, {"_rest_pooling", "rest", NULL}, {"_root_frame", "dynamic", "root"},
      {"_rest_pooling_root_frame", "rest", "root"}, {"_root_frame_rest_pooling", "rest", "root"}};
   static const char *const names[] = {"out.displacement", "out.coarse_displacement", "out.coarse", "out.refined"};
   const outfit *kind = outfits;
   size_t v, q, i, k, nodes, b;
   int any_root = 0;
   while (strcmp(kind->arch, arch) != 0) kind++;
   for (v = 2; v < COUNT(variants); v++)
      for (k = 0; k < COUNT(names); k++) {
         char *name = joined(names[k], variants[v].suffix, "", "");
         any_root |= in(r, name) != NULL;
         free(name);
      }
   for (v = 0; v < COUNT(variants); v++) {
      const dn_tensor *want[COUNT(names)];
      const char *frame = variants[v].frame ? variants[v].frame : any_root ? "model" : NULL; /* NULL: the file's */
      int some = v == 0;
      bytes file_bytes, c;
      suit s;
      for (k = 0; k < COUNT(names); k++) {
         char *name = joined(names[k], variants[v].suffix, "", "");
         want[k] = in(r, name);
         some |= want[k] != NULL;
         free(name);
      }
      if (!some) continue;
      file_bytes = set_meta(r->model->b, "deformnet.pooling", variants[v].pooling);
      if (frame) c = set_meta(file_bytes, "deformnet.frame", frame), free(file_bytes.data), file_bytes = c;
      if (suit_of(r, kind, file_bytes, &s)) {
         const dn_graph *g = &s.view.graph;
         size_t V = s.view.vertices;
         float *got[COUNT(names)], *positions, *moved;
         unsigned char *coarse_short, *felt; /* (poses,N) */
         size_t shorts = 0;
         nodes = s.view.nodes;
         for (k = 0; k < COUNT(names); k++) got[k] = (float *)need(s.poses * nodes * 3, sizeof(float));
         positions = (float *)need(V * 3, sizeof *positions), moved = (float *)need(V * 3, sizeof *moved);
         coarse_short = (unsigned char *)need(s.poses * nodes, 1), felt = (unsigned char *)need(s.poses * nodes, 1);
         if (v == 0) {
            compare_ints(r, in(r, "out.garment_node_of_vertex"), s.view.node_of_vertex, V);
            compare_ints(r, in(r, "out.body_node"), s.view.body_node, nodes);
         }
         for (q = 0; q < s.poses; q++) {
            taps t;
            dn_probe probe = probe_of(&t, r, kind->also);
            dn_garment_nodes at;
            size_t apart = 0;
            if (!suit_run(r, &s, q, NULL, &probe, positions, moved)) {
               taps_free(&t);
               break;
            }
            at = dn_garment_nodes_of(s.garment, s.scratch);
            memcpy(got[0] + q * nodes * 3, kind->refine_out ? at.displacement : at.coarse_displacement, nodes * 12);
            memcpy(got[1] + q * nodes * 3, at.coarse_displacement, nodes * 12);
            memcpy(got[2] + q * nodes * 3, at.coarse, nodes * 12);
            memcpy(got[3] + q * nodes * 3, at.refined, nodes * 12);
            for (i = 0; i < V; i++) /* without a weld distance, what reaches the vertices is exactly their node's */
               apart += !in(r, "in.tolerance") && (memcmp(positions + 3 * i, at.refined + 3 * (size_t)s.view.node_of_vertex[i], 12) != 0 ||
                                                   memcmp(moved + 3 * i, at.displacement + 3 * (size_t)s.view.node_of_vertex[i], 12) != 0);
            if (apart) line(r, "FAIL", "dn_garment_output", "%zu vertices move apart from their nodes", apart);
            i = short_directions(&t, kind->coarse_out, nodes, coarse_short + q * nodes);
            shorts += i;
            memcpy(felt + q * nodes, coarse_short + q * nodes, nodes);
            if (i && kind->refine_out) spread_out(g, felt + q * nodes);
            if (v == 0 && q == 0) {
               float *own = coarse_of_file(r, &s, NULL);
               taps fed;
               const dn_probe see = probe_of(&fed, r, kind->also);
               const tapped *features = NULL;
               workshop shop;
               alone by_itself;
               if (own && suit_run(r, &s, q, own, &see, NULL, NULL)) features = tapped_rows(&fed, "detail.features");
               shop.r = r, shop.s = &s, shop.features = features ? features->rows : NULL;
               by_itself.rows = block_alone, by_itself.user = &shop;
               compare_blocks(r, &t, g, kind->pools, kind->pools[0].prefix ? 2 : 0, i ? felt : NULL, &by_itself);
               taps_free(&fed);
               free(own);
            }
            shorts += short_directions(&t, kind->refine_out, nodes, felt + q * nodes);
            taps_free(&t);
         }
         for (k = 0; k < COUNT(names); k++) {
            int refined = k == 3 || (k == 0 && kind->refine_out != NULL);
            unsigned char *excuse = refined ? felt : coarse_short;
            if (!want[k]) continue;
            if (refined && kind->pools[0].prefix && want[k]->count == s.poses * nodes * 3 && !agrees(want[k], got[k])) { /* may ties explain it? */
               suit dynamic;
               bytes e = set_meta(file_bytes, "deformnet.pooling", "dynamic");
               size_t loose = 0;
               if (suit_of(r, kind, e, &dynamic))
                  for (q = 0; q < s.poses; q++) {
                     taps t;
                     dn_probe probe = probe_of(&t, r, kind->also);
                     if (suit_run(r, &dynamic, s.info.pooling == DN_POOL_REST ? SIZE_MAX : q, NULL, &probe, NULL, NULL))
                        for (b = 0; b < 2; b++) loose += reach_of_pool(r, &t, g, &kind->pools[b], felt + q * nodes);
                     taps_free(&t);
                  }
               suit_free(&dynamic);
               free(e.data);
               printf("       %s%s: %zu nodes hang on scores that tie within %.0e\n", names[k], variants[v].suffix, loose, TIE);
            }
            if (shorts && !agrees(want[k], got[k]))
               printf("       %s%s: %zu directions are shorter than 0.01\n", names[k], variants[v].suffix, shorts);
            if (refined && want[k]->count == s.poses * nodes * 3 && rows_off(want[k], got[k], excuse)) { /* judged by its own stage alone? */
               float *own = coarse_of_file(r, &s, frame), *alone_got = (float *)need(s.poses * nodes * 3, sizeof(float));
               int ok = own != NULL;
               for (q = 0; q < s.poses && ok; q++) {
                  dn_garment_nodes at;
                  ok = suit_run(r, &s, q, own, NULL, NULL, NULL);
                  at = dn_garment_nodes_of(s.garment, s.scratch);
                  memcpy(alone_got + q * nodes * 3, k == 3 ? at.refined : at.displacement, nodes * 12);
               }
               ok = ok && !rows_off(want[k], alone_got, excuse) && rows_off(want[k], got[k], excuse) * 20 <= s.poses * nodes;
               if (ok) compare(r, want[k], "(from the file's coarse garment)", alone_got, s.poses * nodes, 3, 3, excuse);
               free(own);
               free(alone_got);
               if (ok) continue;
            }
            compare(r, want[k], "", got[k], s.poses * nodes, 3, 3, excuse);
         }
         for (k = 0; k < COUNT(names); k++) free(got[k]);
         free(positions);
         free(moved);
         free(coarse_short);
         free(felt);
      }
      suit_free(&s);
      free(file_bytes.data);
   }
}
