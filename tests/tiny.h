/*  tiny.h - inputs of a few kilobytes that are built in memory: model files, a tube to bend, a counting allocator
    include after deformnet.h and test.h */
#ifndef DN_TINY_H
#define DN_TINY_H

/* --- a safetensors writer: tensors in a row, then tiny_file puts header and data together */
typedef struct tiny_writer {
   char header[16384];
   unsigned char data[65536];
   size_t used, bytes;
} tiny_writer;

TEST_UNUSED static void tiny_begin(tiny_writer *w, const char *metadata) /* the inside of __metadata__ */
{
   w->bytes = 0;
   w->used = (size_t)snprintf(w->header, sizeof w->header, "{\"__metadata__\":{%s}", metadata);
}
/* a tensor of that shape, "3,4"; its numbers follow, one by one */
TEST_UNUSED static void tiny_entry(tiny_writer *w, const char *name, const char *type, const char *shape, size_t count)
{
   if (w->used + 256 > sizeof w->header || w->bytes + 4 * count > sizeof w->data) exit(2);
   w->used += (size_t)snprintf(w->header + w->used, sizeof w->header - w->used,
                               ",\"%s\":{\"dtype\":\"%s\",\"shape\":[%s],\"data_offsets\":[%lu,%lu]}", name, type, shape,
                               (unsigned long)w->bytes, (unsigned long)(w->bytes + 4 * count));
}
TEST_UNUSED static void tiny_number(tiny_writer *w, const void *number /* four bytes, this machine's order */)
{
   uint32_t u;
   size_t k;
   memcpy(&u, number, 4);
   for (k = 0; k < 4; k++) w->data[w->bytes++] = (unsigned char)(u >> (8 * k));
}
TEST_UNUSED static void tiny_shaped(tiny_writer *w, const char *name, const char *shape, size_t count, uint64_t *seed,
                                    float low, float high)
{
   size_t i;
   tiny_entry(w, name, "F32", shape, count);
   for (i = 0; i < count; i++) {
      float x = test_uniform(seed, low, high);
      tiny_number(w, &x);
   }
}
TEST_UNUSED static void tiny_tensor(tiny_writer *w, const char *name, size_t rows, size_t columns /* 0: rank 1 */,
                                    uint64_t *seed, float low, float high)
{
   char shape[64];
   if (columns) snprintf(shape, sizeof shape, "%lu,%lu", (unsigned long)rows, (unsigned long)columns);
   else snprintf(shape, sizeof shape, "%lu", (unsigned long)rows);
   tiny_shaped(w, name, shape, rows * (columns ? columns : 1), seed, low, high);
}
/* header (a whole JSON object) and data as a file; spaces are padding after the header */
TEST_UNUSED static unsigned char *tiny_join(const char *header, size_t spaces, const void *data, size_t bytes, size_t *size)
{
   size_t n = strlen(header), k;
   unsigned char *file;
   *size = 8 + n + spaces + bytes;
   file = (unsigned char *)test_block(*size);
   for (k = 0; k < 8; k++) file[k] = (unsigned char)((uint64_t)(n + spaces) >> (8 * k));
   memcpy(file + 8, header, n);
   memset(file + 8 + n, ' ', spaces);
   if (bytes) memcpy(file + 8 + n + spaces, data, bytes);
   return file;
}
TEST_UNUSED static unsigned char *tiny_file(tiny_writer *w, size_t *size)
{
   w->header[w->used++] = '}';
   w->header[w->used] = 0;
   return tiny_join(w->header, 0, w->data, w->bytes, size);
}

#define TINY_META "\"deformnet.version\":\"1\",\"deformnet.unit\":\"1\",\"deformnet.licence\":\"CC0-1.0\","
#define TINY_JOINTS "\"deformnet.joints\":\"hip,knee,foot\""

TEST_UNUSED static void tiny_batchnorm(tiny_writer *w, const char *name, size_t n, uint64_t *seed)
{
   char full[64];
   snprintf(full, sizeof full, "%s.bn.weight", name), tiny_tensor(w, full, n, 0, seed, 0.5f, 1.5f);
   snprintf(full, sizeof full, "%s.bn.bias", name), tiny_tensor(w, full, n, 0, seed, -0.2f, 0.2f);
   snprintf(full, sizeof full, "%s.bn.running_mean", name), tiny_tensor(w, full, n, 0, seed, -0.2f, 0.2f);
   snprintf(full, sizeof full, "%s.bn.running_var", name), tiny_tensor(w, full, n, 0, seed, 0.5f, 1.5f);
}
/* what int8 needs to know of a layer's output; only in files made while tiny_ranges is set */
static int tiny_ranges;
TEST_UNUSED static void tiny_range(tiny_writer *w, const char *name, size_t out, uint64_t *seed)
{
   char full[64], shape[64];
   size_t i;
   if (!tiny_ranges) return;
   snprintf(full, sizeof full, "%s.range", name), snprintf(shape, sizeof shape, "2,%lu", (unsigned long)out);
   tiny_entry(w, full, "F32", shape, 2 * out);
   for (i = 0; i < 2 * out; i++) {
      float x = i < out ? test_uniform(seed, -2, -1) : test_uniform(seed, 1, 2);
      tiny_number(w, &x);
   }
}
TEST_UNUSED static void tiny_lifted(tiny_writer *w, const char *name, size_t out, size_t in, uint64_t *seed, float lift)
{
   char full[64];
   snprintf(full, sizeof full, "%s.weight", name), tiny_tensor(w, full, out, in, seed, lift - 0.7f, 0.7f);
   snprintf(full, sizeof full, "%s.bias", name), tiny_tensor(w, full, out, 0, seed, lift - 0.2f, lift + 0.2f);
   tiny_range(w, name, out, seed);
}
TEST_UNUSED static void tiny_linear(tiny_writer *w, const char *name, size_t out, size_t in, uint64_t *seed)
{
   tiny_lifted(w, name, out, in, seed, 0);
}
/* K = F = B = 2: 6 wide. Its weights are large: what tanhshrink makes of small rows, cubes, soon vanishes */
TEST_UNUSED static void tiny_gat(tiny_writer *w, const char *name, size_t in, uint64_t *seed)
{
   char full[64];
   snprintf(full, sizeof full, "%s.lin.weight", name), tiny_tensor(w, full, 4, in, seed, -2.5f, 2.5f);
   snprintf(full, sizeof full, "%s.att_dst", name), tiny_tensor(w, full, 2, 2, seed, -0.7f, 0.7f);
   snprintf(full, sizeof full, "%s.att_src", name), tiny_tensor(w, full, 2, 2, seed, -0.7f, 0.7f);
   snprintf(full, sizeof full, "%s.self.weight", name), tiny_tensor(w, full, 2, in, seed, -2.5f, 2.5f);
   tiny_range(w, name, 6, seed);
}
/* 6 -> 5 -> 3, about 1.6 kB; no joint names */
TEST_UNUSED static unsigned char *tiny_mlp(size_t *size)
{
   static tiny_writer w;
   uint64_t seed = 1;
   tiny_begin(&w, TINY_META "\"deformnet.arch\":\"mlp\",\"deformnet.features\":\"relative,normal\",\"deformnet.frame\":\"root\"");
   tiny_tensor(&w, "input.mean", 6, 0, &seed, -0.1f, 0.1f);
   tiny_tensor(&w, "input.std", 6, 0, &seed, 0.5f, 1.5f);
   tiny_linear(&w, "pre.0", 5, 6, &seed);
   tiny_batchnorm(&w, "pre.0", 5, &seed);
   tiny_linear(&w, "out", 3, 5, &seed);
   tiny_tensor(&w, "output.std", 3, 0, &seed, 0.01f, 0.02f);
   tiny_tensor(&w, "output.mean", 3, 0, &seed, -0.01f, 0.01f);
   return tiny_file(&w, size);
}
/* the smallest network with every part: pre, local, pool, global, post; about 6 kB. D = 6 + one per-joint feature */
TEST_UNUSED static unsigned char *tiny_multires(const char *joint_feature, const char *pooling, size_t *size)
{
   static tiny_writer w;
   uint64_t seed = 2;
   char meta[512];
   snprintf(meta, sizeof meta, TINY_META TINY_JOINTS ",\"deformnet.arch\":\"multiresgnet\",\"deformnet.frame\":\"model\","
            "\"deformnet.features\":\"relative,normal,%s\",\"deformnet.pooling\":\"%s\"", joint_feature, pooling);
   tiny_begin(&w, meta);
   tiny_linear(&w, "pre.0", 6, 9, &seed);
   tiny_batchnorm(&w, "pre.0", 6, &seed);
   tiny_linear(&w, "pre.1", 4, 6, &seed);
   tiny_gat(&w, "local.0", 4, &seed);
   tiny_gat(&w, "local.1", 10, &seed);
   tiny_tensor(&w, "pool.lin.weight", 2, 4, &seed, -1.0f, 1.0f);
   tiny_tensor(&w, "pool.att_dst", 1, 2, &seed, -1.0f, 1.0f);
   tiny_tensor(&w, "pool.att_src", 1, 2, &seed, -1.0f, 1.0f);
   tiny_range(&w, "pool", 4, &seed), tiny_range(&w, "unpool", 6, &seed);
   tiny_gat(&w, "global.0", 4, &seed);
   tiny_gat(&w, "global.1", 6, &seed);
   tiny_gat(&w, "global.2", 6, &seed);
   tiny_linear(&w, "post.0", 5, 22, &seed);
   tiny_linear(&w, "post.1", 4, 5, &seed);
   tiny_linear(&w, "out", 3, 4, &seed);
   tiny_tensor(&w, "output.std", 3, 0, &seed, 0.01f, 0.02f);
   tiny_tensor(&w, "output.mean", 3, 0, &seed, -0.01f, 0.01f);
   return tiny_file(&w, size);
}

/* garments' networks, every block 6 wide; 19 and 15 kB. Joints and shape parameters: those of tiny_wear */
TEST_UNUSED static void tiny_pool(tiny_writer *w, const char *name, size_t in, uint64_t *seed)
{
   char full[64];
   snprintf(full, sizeof full, "%s.lin.weight", name), tiny_tensor(w, full, 2, in, seed, -1.0f, 1.0f);
   snprintf(full, sizeof full, "%s.att_dst", name), tiny_tensor(w, full, 1, 2, seed, -1.0f, 1.0f);
   snprintf(full, sizeof full, "%s.att_src", name), tiny_tensor(w, full, 1, 2, seed, -1.0f, 1.0f);
}
TEST_UNUSED static void tiny_head(tiny_writer *w, const char *prefix, size_t in, size_t out, uint64_t *seed)
{
   char full[64];
   float lift = out == 1 ? 0.35f : 0; /* of the numbers that go through relu enough remain */
   snprintf(full, sizeof full, "%spost.0", prefix), tiny_lifted(w, full, 5, in, seed, lift);
   snprintf(full, sizeof full, "%spost.1", prefix), tiny_lifted(w, full, 4, 5, seed, lift);
   snprintf(full, sizeof full, "%sout", prefix), tiny_lifted(w, full, out, 4, seed, lift);
}
enum { TINY_ALPHAS = 2, TINY_BETAS = 1, TINY_THETAS = 4, TINY_SHAPE = TINY_ALPHAS + TINY_BETAS + TINY_THETAS };
TEST_UNUSED static unsigned char *tiny_cloth(const char *pooling, size_t *size)
{
   static tiny_writer w;
   uint64_t seed = 3;
   char meta[512], name[64];
   size_t k, b;
   snprintf(meta, sizeof meta, TINY_META TINY_JOINTS ",\"deformnet.arch\":\"clothnet\",\"deformnet.frame\":\"root\","
            "\"deformnet.features\":\"normal,relative,fit:1\",\"deformnet.features.detail\":\"normal,relative,distance\","
            "\"deformnet.pooling\":\"%s\"", pooling);
   tiny_begin(&w, meta);
   tiny_gat(&w, "coarse.gat", 7, &seed);
   tiny_gat(&w, "detail.gat", 9, &seed);
   tiny_linear(&w, "parser.0", 5, TINY_SHAPE, &seed);
   tiny_linear(&w, "parser.1", 4, 5, &seed);
   tiny_linear(&w, "parser.2", 6, 4, &seed);
   for (k = 0; k < 2; k++) {
      const char *head = k ? "len." : "dir.";
      for (b = 0; b < 7; b++) {
         if (b < 3) snprintf(name, sizeof name, "coarse.%sgat.%lu", head, (unsigned long)b);
         else snprintf(name, sizeof name, "detail.%sgat.%lu", head, (unsigned long)(b - 3));
         tiny_gat(&w, name, 6, &seed);
      }
      snprintf(name, sizeof name, "detail.%spool", head), tiny_pool(&w, name, 6, &seed);
      snprintf(name, sizeof name, "coarse.%s", head), tiny_head(&w, name, 6, k ? 1 : 3, &seed);
      snprintf(name, sizeof name, "detail.%s", head), tiny_head(&w, name, 6, k ? 1 : 3, &seed);
   }
   tiny_tensor(&w, "coarse.output.std", 3, 0, &seed, 0.01f, 0.02f);
   tiny_tensor(&w, "detail.output.std", 3, 0, &seed, 0.01f, 0.02f);
   tiny_tensor(&w, "detail.input.std", 9, 0, &seed, 0.5f, 1.5f);
   return tiny_file(&w, size);
}
TEST_UNUSED static unsigned char *tiny_garfit(const char *pooling, size_t *size)
{
   static tiny_writer w;
   uint64_t seed = 4;
   char meta[512], name[64];
   size_t k, b;
   snprintf(meta, sizeof meta, TINY_META TINY_JOINTS ",\"deformnet.arch\":\"garfitnet\",\"deformnet.frame\":\"model\","
            "\"deformnet.features\":\"relative,normal,distance\",\"deformnet.pooling\":\"%s\"", pooling);
   tiny_begin(&w, meta);
   tiny_gat(&w, "gat.0", 9, &seed);
   tiny_gat(&w, "gat.1", 6, &seed);
   tiny_linear(&w, "fit.0", 5, TINY_SHAPE, &seed);
   tiny_linear(&w, "fit.1", 4, 5, &seed);
   tiny_linear(&w, "fit.2", 12, 4, &seed);
   for (k = 0; k < 2; k++) {
      const char *head = k ? "len." : "dir.";
      for (b = 0; b < 4; b++) snprintf(name, sizeof name, "%slocal.%lu", head, (unsigned long)b), tiny_gat(&w, name, 12 + 6 * b, &seed);
      snprintf(name, sizeof name, "%spool", head), tiny_pool(&w, name, 12, &seed);
      for (b = 0; b < 3; b++) snprintf(name, sizeof name, "%sglobal.%lu", head, (unsigned long)b), tiny_gat(&w, name, b ? 6 : 12, &seed);
      tiny_head(&w, head, 42, k ? 1 : 3, &seed);
   }
   tiny_tensor(&w, "output.std", 3, 0, &seed, 0.01f, 0.02f);
   return tiny_file(&w, size);
}

/* the other architectures, every block 6 wide as well */
TEST_UNUSED static unsigned char *tiny_gats(const char *arch /* "gat" or "neuroskinning" */, size_t *size)
{
   static tiny_writer w;
   uint64_t seed = 5;
   char meta[512];
   int linear = arch[0] == 'n';
   snprintf(meta, sizeof meta, TINY_META TINY_JOINTS ",\"deformnet.arch\":\"%s\",\"deformnet.frame\":\"root\","
            "\"deformnet.features\":\"position,normal,distance\"", arch);
   tiny_begin(&w, meta);
   if (linear) tiny_linear(&w, "pre.0", 5, 9, &seed), tiny_linear(&w, "pre.1", 4, 5, &seed);
   tiny_gat(&w, "gat.0", linear ? 4 : 9, &seed);
   tiny_gat(&w, "gat.1", 6, &seed);
   tiny_batchnorm(&w, "gat.1", 6, &seed);
   tiny_gat(&w, "gat.2", 6, &seed);
   if (linear) tiny_linear(&w, "post.0", 6, 6, &seed);
   tiny_linear(&w, "out", 3, 6, &seed);
   tiny_tensor(&w, "output.std", 3, 0, &seed, 0.01f, 0.02f);
   return tiny_file(&w, size);
}
TEST_UNUSED static unsigned char *tiny_dense(size_t *size) /* 40 and twice 42 wide, 22 kB */
{
   static tiny_writer w;
   uint64_t seed = 6;
   char name[64];
   size_t m, b, in = 4;
   tiny_begin(&w, TINY_META TINY_JOINTS ",\"deformnet.arch\":\"densegats\",\"deformnet.frame\":\"model\","
              "\"deformnet.features\":\"position,normal,geodesic\"");
   tiny_linear(&w, "pre.0", 5, 9, &seed);
   tiny_batchnorm(&w, "pre.0", 5, &seed);
   tiny_linear(&w, "pre.1", 4, 5, &seed);
   for (m = 0; m < 3; m++, in = 6) {
      for (b = 0; b < 6; b++) snprintf(name, sizeof name, "dense.%lu.%lu", (unsigned long)m, (unsigned long)b), tiny_gat(&w, name, in + 6 * b, &seed);
      snprintf(name, sizeof name, "transition.%lu", (unsigned long)m);
      if (m < 2) tiny_gat(&w, name, in + 36, &seed);
   }
   tiny_linear(&w, "post.0", 5, 42, &seed);
   tiny_linear(&w, "post.1", 4, 5, &seed);
   tiny_linear(&w, "out", 3, 4, &seed);
   tiny_tensor(&w, "output.std", 3, 0, &seed, 0.01f, 0.02f);
   return tiny_file(&w, size);
}
TEST_UNUSED static unsigned char *tiny_coarse(size_t *size) /* garfit_coarse */
{
   static tiny_writer w;
   uint64_t seed = 7;
   char name[64];
   size_t b;
   tiny_begin(&w, TINY_META TINY_JOINTS ",\"deformnet.arch\":\"garfit_coarse\",\"deformnet.frame\":\"root\","
              "\"deformnet.features\":\"relative,normal,fit:2\"");
   for (b = 0; b < 4; b++) snprintf(name, sizeof name, "gat.%lu", (unsigned long)b), tiny_gat(&w, name, b ? 6 : 8, &seed);
   tiny_linear(&w, "dir.out", 3, 6, &seed);
   tiny_lifted(&w, "len.out", 1, 6, &seed, 0.35f);
   tiny_tensor(&w, "output.std", 3, 0, &seed, 0.01f, 0.02f);
   return tiny_file(&w, size);
}
/* neuralblendshapes of three joints and two shapes; lists of widths end at 0 */
TEST_UNUSED static void tiny_chain(tiny_writer *w, const char *stem, const size_t *width, size_t joints /* 0: convolutions */,
                                   uint64_t *seed)
{
   size_t i, J = joints ? joints : 1;
   char name[64], shape[64];
   for (i = 0; width[i + 1]; i++) {
      size_t out = J * width[i + 1], in = J * width[i];
      snprintf(name, sizeof name, "%s%lu.weight", stem, (unsigned long)i);
      snprintf(shape, sizeof shape, joints ? "%lu,%lu" : "%lu,%lu,1,5", (unsigned long)out, (unsigned long)in);
      tiny_shaped(w, name, shape, out * in * (joints ? 1 : 5), seed, -0.7f, 0.7f);
      snprintf(name, sizeof name, "%s%lu.bias", stem, (unsigned long)i);
      tiny_tensor(w, name, out, 0, seed, -0.2f, 0.2f);
   }
}
TEST_UNUSED static unsigned char *tiny_blend(size_t *size)
{
   static tiny_writer w;
   static const size_t att[] = {3, 6, 3, 0}, geo[] = {3, 7, 6, 0}, gen[] = {6, 4, 3, 0}, geo2[] = {3, 6, 0}, dec[] = {9, 6, 0}, coff[] = {9, 4, 2, 0};
   uint64_t seed = 8;
   tiny_begin(&w, TINY_META "\"deformnet.arch\":\"neuralblendshapes\",\"deformnet.parents\":\"-1,0,1\"");
   tiny_chain(&w, "att.", att, 0, &seed);
   tiny_chain(&w, "geo.", geo, 0, &seed);
   tiny_chain(&w, "gen.", gen, 3, &seed);
   tiny_chain(&w, "geo2.", geo2, 0, &seed);
   tiny_chain(&w, "dec.", dec, 0, &seed);
   tiny_chain(&w, "coff.0.", coff, 1, &seed);
   tiny_chain(&w, "coff.1.", coff, 1, &seed);
   return tiny_file(&w, size);
}

/* --- a tube of 7 rings of 6 vertices around a chain hip - knee - foot; each test spoils its own copy */
enum { TUBE_RINGS = 7, TUBE_AROUND = 6, TUBE_V = TUBE_RINGS * TUBE_AROUND, TUBE_T = 2 * (TUBE_RINGS - 1) * TUBE_AROUND, TUBE_S = 3 };
typedef struct tube {
   float positions[TUBE_V * 3], weights[TUBE_V * 2], inverse_bind[TUBE_S * 12], palette[TUBE_S * 12];
   const float *pose; /* palette, unless a test has a larger one */
   uint8_t joints[TUBE_V * 2];
   uint16_t indices[TUBE_T * 3];
   int32_t parents[TUBE_S];
   const char *names[TUBE_S];
   dn_skin_set skin;
   dn_rig_desc desc;
} tube;

TEST_UNUSED static void tube_make(tube *t)
{
   static const float ring[TUBE_AROUND][2] = {{1, 0}, {0.5f, 0.866f}, {-0.5f, 0.866f}, {-1, 0}, {-0.5f, -0.866f}, {0.5f, -0.866f}};
   static const char *const names[TUBE_S] = {"hip", "knee", "foot"};
   size_t r, a, s, n = 0;
   memset(t, 0, sizeof *t);
   for (r = 0; r < TUBE_RINGS; r++)
      for (a = 0; a < TUBE_AROUND; a++) {
         size_t v = r * TUBE_AROUND + a;
         static const float first[TUBE_RINGS] = {1, 1, 1, 0.5f, 1, 0.5f, 0}; /* weight of the joint nearer the hip */
         float x = (float)r * 0.2f, w = first[r];
         t->positions[3 * v] = x;
         t->positions[3 * v + 1] = 0.15f * ring[a][0];
         t->positions[3 * v + 2] = 0.15f * ring[a][1];
         t->joints[2 * v] = (uint8_t)(r < 4 ? 0 : 1);
         t->joints[2 * v + 1] = (uint8_t)(r < 4 ? 1 : 2);
         t->weights[2 * v] = w;
         t->weights[2 * v + 1] = 1.0f - w;
         if (r + 1 < TUBE_RINGS) {
            size_t b = r * TUBE_AROUND + (a + 1) % TUBE_AROUND;
            t->indices[n++] = (uint16_t)v, t->indices[n++] = (uint16_t)b, t->indices[n++] = (uint16_t)(v + TUBE_AROUND);
            t->indices[n++] = (uint16_t)b, t->indices[n++] = (uint16_t)(b + TUBE_AROUND), t->indices[n++] = (uint16_t)(v + TUBE_AROUND);
         }
      }
   for (s = 0; s < TUBE_S; s++) {
      float *m = t->inverse_bind + 12 * s, *p = t->palette + 12 * s, c = s == 0 ? 1.0f : s == 1 ? 0.8f : 0.28f,
            d = s == 0 ? 0.0f : s == 1 ? 0.6f : 0.96f;
      m[0] = m[5] = m[10] = 1.0f;
      m[3] = -0.6f * (float)s;
      p[0] = c, p[1] = -d, p[4] = d, p[5] = c, p[10] = 1.0f; /* about z, around the knee */
      p[3] = 0.6f - 0.6f * c, p[7] = -0.6f * d;
      t->parents[s] = (int32_t)s - 1;
      t->names[s] = names[s];
   }
   t->pose = t->palette;
   t->skin.influences = 2;
   t->skin.joints = t->joints;
   t->skin.joint_type = DN_U8;
   t->skin.weights = t->weights;
   t->skin.weight_type = DN_F32;
   t->desc.mesh.vertices = TUBE_V;
   t->desc.mesh.positions = t->positions;
   t->desc.mesh.triangles = TUBE_T;
   t->desc.mesh.indices = t->indices;
   t->desc.mesh.index_type = DN_U16;
   t->desc.mesh.skin_sets = 1;
   t->desc.mesh.skin = &t->skin;
   t->desc.skeleton.joints = TUBE_S;
   t->desc.skeleton.names = t->names;
   t->desc.skeleton.parents = t->parents;
   t->desc.skeleton.inverse_bind = t->inverse_bind;
   t->desc.skeleton.matrix = DN_3X4_ROWS;
   t->desc.resolution = 16;
}

/* --- an allocator that counts, checks what free is told, and fails on request */
typedef struct counting {
   long fail_at;              /* this allocation, from 0, fails; -1: none */
   long calls, live;
   size_t bytes, peak, total; /* live now, most ever, sum of all */
   size_t wrong;              /* zero sizes, odd alignments, frees with another size or of strangers */
   int fill;                  /* what fresh memory holds: uninitialised reads show */
} counting;
TEST_UNUSED static void *counting_alloc(void *user, size_t size, size_t align)
{
   counting *c = (counting *)user;
   unsigned char *raw, *p;
   size_t i;
   c->wrong += size == 0 || align == 0 || (align & (align - 1)) != 0;
   if (c->calls++ == c->fail_at) return NULL;
   if (size > (size_t)1 << 30) return NULL;
   raw = (unsigned char *)malloc(size + align + 2 * sizeof(size_t) + sizeof(void *));
   if (!raw) return NULL;
   p = raw + 2 * sizeof(size_t) + sizeof(void *);
   p += (align - ((size_t)(uintptr_t)p & (align - 1))) & (align - 1);
   memcpy(p - sizeof(void *), &raw, sizeof raw);
   i = ~size;
   memcpy(p - sizeof(void *) - sizeof(size_t), &size, sizeof size);
   memcpy(p - sizeof(void *) - 2 * sizeof(size_t), &i, sizeof i);
   memset(p, c->fill, size);
   c->live++;
   c->bytes += size;
   c->total += size;
   if (c->bytes > c->peak) c->peak = c->bytes;
   return p;
}
TEST_UNUSED static void counting_free(void *user, void *ptr, size_t size)
{
   counting *c = (counting *)user;
   unsigned char *p = (unsigned char *)ptr;
   size_t was, inverse;
   void *raw;
   if (!ptr) {
      c->wrong++;
      return;
   }
   memcpy(&raw, p - sizeof(void *), sizeof raw);
   memcpy(&was, p - sizeof(void *) - sizeof(size_t), sizeof was);
   memcpy(&inverse, p - sizeof(void *) - 2 * sizeof(size_t), sizeof inverse);
   if (was != ~inverse) {
      c->wrong++;
      return;
   }
   c->wrong += size != was;
   c->live--;
   c->bytes -= was;
   free(raw);
}
TEST_UNUSED static dn_allocator counting_allocator(counting *c, long fail_at)
{
   dn_allocator a;
   memset(c, 0, sizeof *c);
   c->fail_at = fail_at;
   c->fill = 0xa5;
   a.alloc = counting_alloc;
   a.free = counting_free;
   a.user = c;
   return a;
}

/* --- bind the tube and deform it once. Returns what failed, or dn_deform's result; out (TUBE_V,3) */
TEST_UNUSED static dn_result tiny_deform(const dn_model *model, const tube *t, float *out, dn_output *info,
                                         const dn_allocator *allocator, dn_error *err)
{
   dn_rig *rig = dn_rig_create(model, &t->desc, allocator, NULL, err);
   dn_pose pose;
   dn_output output;
   dn_result r;
   size_t bytes;
   void *scratch;
   if (!rig) return err->code;
   memset(&pose, 0, sizeof pose);
   memset(&output, 0, sizeof output);
   pose.palette = t->pose;
   pose.matrix = DN_3X4_ROWS;
   pose.strength = 1.0f;
   output.positions = out;
   bytes = dn_scratch_size(rig, 1);
   scratch = test_aligned(bytes);
   memset(scratch, 0xa5, bytes);
   r = dn_deform(rig, &pose, &output, scratch, bytes, NULL, err);
   if (info) *info = output;
   test_aligned_free(scratch);
   dn_rig_free(rig);
   return r;
}
/* the same for a garment's model: the tube wears itself, a little wider; out (TUBE_V,3) */
TEST_UNUSED static dn_result tiny_wear(const dn_model *model, const tube *t, float *out, dn_garment_output *info,
                                       const dn_allocator *allocator, dn_error *err)
{
   static const float shape[TINY_SHAPE] = {0.5f, -0.3f, 0.7f, 0.2f, -0.1f, 0.4f, 0.6f}; /* alpha, beta, theta */
   float wider[TUBE_V * 3];
   dn_garment_desc d;
   dn_garment_pose pose;
   dn_garment_output output;
   dn_model_info m;
   dn_garment *g;
   dn_result r;
   size_t bytes, i;
   void *scratch;
   for (i = 0; i < TUBE_V * 3; i++) wider[i] = i % 3 ? 1.2f * t->positions[i] : t->positions[i];
   dn_model_describe(model, &m);
   memset(&d, 0, sizeof d);
   memset(&pose, 0, sizeof pose);
   memset(&output, 0, sizeof output);
   d.body = t->desc.mesh;
   d.skeleton = t->desc.skeleton;
   d.garment.vertices = TUBE_V, d.garment.positions = wider;
   d.garment.triangles = TUBE_T, d.garment.indices = t->indices, d.garment.index_type = DN_U16;
   if (m.arch == DN_GARFIT_COARSE) d.coarse = model;
   else d.refine = model;
   d.alpha = shape, d.alphas = TINY_ALPHAS;
   d.beta = shape + TINY_ALPHAS, d.betas = TINY_BETAS;
   d.thetas = TINY_THETAS;
   g = dn_garment_create(&d, allocator, NULL, err);
   if (!g) return err->code;
   pose.palette = t->pose;
   pose.matrix = DN_3X4_ROWS;
   pose.theta = shape + TINY_ALPHAS + TINY_BETAS;
   pose.strength = 1.0f;
   output.positions = out;
   bytes = dn_garment_scratch_size(g, 1);
   scratch = test_aligned(bytes);
   memset(scratch, 0xa5, bytes);
   r = dn_garment_deform(g, &pose, &output, scratch, bytes, NULL, err);
   if (info) *info = output;
   test_aligned_free(scratch);
   dn_garment_free(g);
   return r;
}
#endif
