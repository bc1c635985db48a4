/*  dressed.c - the dressed character on a made body of five joints and garments that follow it
    shows     each step of a frame against the library's own parts, changes against creation anew, collisions, layers,
              any split of the work, refusals, allocations that fail
    build     cc -g -fsanitize=address,undefined dressed.c -o dressed -lm
    run       ./dressed [part of a test's name]        from this directory: it reads data/golden */
#define DEFORMNET_IMPLEMENTATION
#include "../deformnet.h"
#include "test.h"
#include "tiny.h"
#include <math.h>

static void backwards(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job)
{
   size_t ranges = (count + grain - 1) / grain, r;
   (void)user;
   for (r = ranges; r-- > 0;) fn(job, r * grain, (r + 1) * grain < count ? (r + 1) * grain : count, (unsigned)(r % 3));
}

/* --- files: a chain of five joints up the y axis, a closed tube round it, open tubes round that */
enum { AROUND = 12, S = 5, B = 10 };
typedef struct made { size_t v, t; float *rest, *dirs, *weights, *loose, *pose; int32_t *faces; } made;
static made tube_of(size_t rings, float radius, float low, float high, int closed)
{
   made m;
   uint64_t seed = 5;
   size_t i, j, k, n = 0;
   m.v = rings * AROUND + (closed ? 2 : 0);
   m.t = 2 * AROUND * (rings - 1) + (closed ? 2 * AROUND : 0);
   m.rest = (float *)test_block(12 * m.v), m.loose = (float *)test_block(12 * m.v);
   m.dirs = (float *)test_block(12 * B * m.v), m.weights = (float *)test_block(4 * S * m.v), m.pose = (float *)test_block(12 * 9 * (S - 1) * m.v);
   m.faces = (int32_t *)test_block(12 * m.t);
   for (i = 0; i < m.v; i++) {
      size_t ring = i / AROUND;
      double a = 6.28318530717959 * (double)(i % AROUND) / AROUND, out = ring < rings ? 1 : 0;
      float y = ring < rings ? low + (high - low) * (float)ring / (float)(rings - 1) : i == m.v - 2 ? low - 0.5f * radius : high + 0.5f * radius;
      float *p = m.rest + 3 * i, at = y * 4.0f;
      p[0] = radius * (float)(out * cos(a)), p[1] = y, p[2] = -radius * (float)(out * sin(a));
      m.loose[3 * i] = (float)(out * cos(a)), m.loose[3 * i + 1] = 0, m.loose[3 * i + 2] = (float)(out * -sin(a));
      for (j = 0; j < S; j++) {
         float w = 1.0f - fabsf(at - (float)j - 0.5f); /* joint j moves the piece above it */
         if (j == 0 && at < 0.5f) w = 1;
         if (j == S - 1 && at > (float)S - 0.5f) w = 1;
         m.weights[S * i + j] = w > 0 ? w : 0;
      }
      for (k = 0; k < B; k++)
         for (j = 0; j < 3; j++) /* beta 0 is girth, beta 1 height, the others some waves, all of the place alone */
            m.dirs[(3 * i + j) * B + k] = k == 0 ? (j == 1 ? 0 : 0.01f * p[j] / (radius + 1e-6f)) : k == 1 ? (j == 1 ? 0.05f * y : 0)
                                        : 0.002f * (float)sin((double)(k * (size_t)(j + 1)) + 3.0 * (double)y);
   }
   for (i = 0; i < 3 * 9 * (S - 1) * m.v; i++) m.pose[i] = test_uniform(&seed, -0.001f, 0.001f);
   for (i = 0; i + 1 < rings; i++)
      for (j = 0; j < AROUND; j++) {
         int32_t a = (int32_t)(i * AROUND + j), b = (int32_t)(i * AROUND + (j + 1) % AROUND), c = a + AROUND, d = b + AROUND;
         m.faces[n++] = a, m.faces[n++] = b, m.faces[n++] = c;
         m.faces[n++] = b, m.faces[n++] = d, m.faces[n++] = c;
      }
   for (j = 0; closed && j < AROUND; j++) {
      m.faces[n++] = (int32_t)((j + 1) % AROUND), m.faces[n++] = (int32_t)j, m.faces[n++] = (int32_t)(m.v - 2);
      m.faces[n++] = (int32_t)((rings - 1) * AROUND + j), m.faces[n++] = (int32_t)((rings - 1) * AROUND + (j + 1) % AROUND), m.faces[n++] = (int32_t)(m.v - 1);
   }
   return m;
}
static void made_free(made *m) { free(m->rest), free(m->dirs), free(m->weights), free(m->loose), free(m->pose), free(m->faces); }

typedef struct writer { char header[4096]; unsigned char *data; size_t used, bytes; } writer;
static void put(writer *w, const char *name, const char *type, const char *shape, const void *numbers, size_t count)
{
   size_t i, k;
   w->used += (size_t)snprintf(w->header + w->used, sizeof w->header - w->used, ",\"%s\":{\"dtype\":\"%s\",\"shape\":[%s],\"data_offsets\":[%lu,%lu]}",
                               name, type, shape, (unsigned long)w->bytes, (unsigned long)(w->bytes + 4 * count));
   w->data = (unsigned char *)realloc(w->data, w->bytes + 4 * count);
   if (!w->data) exit(2);
   for (i = 0; i < count; i++) {
      uint32_t u;
      memcpy(&u, (const unsigned char *)numbers + 4 * i, 4);
      for (k = 0; k < 4; k++) w->data[w->bytes++] = (unsigned char)(u >> (8 * k));
   }
}
enum { JOINTS = 1, PARENTS = 2, LOOSE = 4, POSE = 8 };
static dn_shape *shape_of(const made *m, int parts, const dn_allocator *a)
{
   static const int32_t parents[S] = {-1, 0, 1, 2, 3};
   writer w;
   char shape[64];
   float joints[3 * S], joint_dirs[3 * S * B];
   size_t j, k, size;
   unsigned char *file;
   dn_shape *s;
   dn_error e;
   memset(&w, 0, sizeof w);
   memset(joints, 0, sizeof joints), memset(joint_dirs, 0, sizeof joint_dirs);
   for (j = 0; j < S; j++)
      for (joints[3 * j + 1] = 0.25f * (float)j, k = 0; k < 1; k++) joint_dirs[(3 * j + 1) * B + 1] = 0.05f * 0.25f * (float)j;
   w.used = (size_t)snprintf(w.header, sizeof w.header, "{\"__metadata__\":{\"joint_names\":\"[\\\"joint0\\\",\\\"joint1\\\",\\\"joint2\\\",\\\"joint3\\\",\\\"joint4\\\"]\"}");
   snprintf(shape, sizeof shape, "%lu,3", (unsigned long)m->v), put(&w, "template", "F32", shape, m->rest, 3 * m->v);
   if (parts & LOOSE) put(&w, "looseness_dirs", "F32", shape, m->loose, 3 * m->v);
   snprintf(shape, sizeof shape, "%lu,3", (unsigned long)m->t), put(&w, "faces", "I32", shape, m->faces, 3 * m->t);
   snprintf(shape, sizeof shape, "%lu,3,10", (unsigned long)m->v), put(&w, "shapedirs", "F32", shape, m->dirs, 3 * B * m->v);
   snprintf(shape, sizeof shape, "%lu,5", (unsigned long)m->v), put(&w, "weights", "F32", shape, m->weights, S * m->v);
   snprintf(shape, sizeof shape, "%lu,3,36", (unsigned long)m->v);
   if (parts & POSE) put(&w, "posedirs", "F32", shape, m->pose, 3 * 9 * (S - 1) * m->v);
   if (parts & JOINTS) put(&w, "joint_template", "F32", "5,3", joints, 3 * S), put(&w, "joint_shapedirs", "F32", "5,3,10", joint_dirs, 3 * S * B);
   if (parts & PARENTS) put(&w, "parents", "I32", "5", parents, S);
   w.header[w.used++] = '}', w.header[w.used] = 0;
   file = tiny_join(w.header, 0, w.data, w.bytes, &size);
   s = dn_shape_load(file, size, a, &e);
   if (!s) printf("the made shape is refused: %s\n", e.info), exit(2);
   free(file), free(w.data);
   return s;
}

/* --- a character with two garments, given in the wrong order of layers */
typedef struct wardrobe {
   made body_made, inner_made, outer_made;
   dn_shape *body, *inner, *outer;
   dn_dressed_garment garment[2];
   dn_dressed_desc desc;
   float beta[B], alpha[3], theta[3 * S], parameters[72];
   size_t v[3];
} wardrobe;
static void wardrobe_open(wardrobe *w, int body_parts)
{
   size_t i;
   memset(w, 0, sizeof *w);
   w->body_made = tube_of(21, 0.1f, 0.0f, 1.2f, 1);
   w->inner_made = tube_of(17, 0.106f, 0.2f, 0.9f, 0);
   w->outer_made = tube_of(19, 0.112f, 0.15f, 1.0f, 0);
   w->body = shape_of(&w->body_made, body_parts, NULL);
   w->inner = shape_of(&w->inner_made, LOOSE, NULL);
   w->outer = shape_of(&w->outer_made, LOOSE, NULL);
   w->garment[0].shape = w->outer, w->garment[0].layer = 3, w->garment[0].margin = 0.003f;
   w->garment[1].shape = w->inner, w->garment[1].layer = 1, w->garment[1].margin = 0.003f;
   for (i = 0; i < 3; i++) w->alpha[i] = 0.1f * (float)i;
   for (i = 0; i < 72; i++) w->parameters[i] = 0.05f * (float)(i % 5);
   w->desc.body = w->body, w->desc.garment = w->garment, w->desc.garments = 2;
   w->desc.beta = w->beta, w->desc.betas = B;
   w->v[0] = w->outer_made.v, w->v[1] = w->inner_made.v, w->v[2] = w->body_made.v;
}
static void wardrobe_close(wardrobe *w)
{
   dn_shape_free(w->body), dn_shape_free(w->inner), dn_shape_free(w->outer);
   made_free(&w->body_made), made_free(&w->inner_made), made_free(&w->outer_made);
}
static dn_dressed *dress(const wardrobe *w)
{
   dn_error e;
   dn_dressed *d = dn_dressed_create(&w->desc, NULL, &e);
   CHECK_MSG(d != NULL, "%s", d ? "" : e.info);
   if (!d) exit(1);
   return d;
}
typedef struct frame { dn_dressed_mesh mesh[3]; float palette[12 * S]; uint64_t hash; dn_result result; } frame; /* outer, inner, body */
static frame frame_of(const wardrobe *w, const dn_dressed *d, const dn_dressed_pose *pose, const dn_parallel *par)
{
   frame f;
   size_t i, bytes = dn_dressed_scratch_size(d, par ? par->workers : 1);
   void *scratch = test_aligned(bytes);
   dn_error e;
   memset(&f, 0, sizeof f);
   memset(scratch, 0xb7, bytes);
   for (i = 0; i < 3; i++) f.mesh[i].positions = (float *)test_block(12 * w->v[i]), f.mesh[i].normals = (float *)test_block(12 * w->v[i]);
   f.result = dn_dressed_deform(d, pose, &f.mesh[2], f.mesh, f.palette, scratch, bytes, par, &e);
   f.hash = 14695981039346656037u;
   for (i = 0; i < 3; i++) {
      f.hash = test_hash(f.hash, f.mesh[i].positions, 12 * w->v[i]);
      f.hash = test_hash(f.hash, f.mesh[i].normals, 12 * w->v[i]);
      f.hash = test_hash(f.hash, &f.mesh[i].collision, sizeof f.mesh[i].collision);
   }
   f.hash = test_hash(f.hash, f.palette, sizeof f.palette);
   CHECK(dn_dressed_deform(d, pose, &f.mesh[2], f.mesh, NULL, scratch, bytes - 1, par, &e) == DN_TOO_SMALL && strstr(e.info, "scratch"));
   test_aligned_free(scratch);
   return f;
}
static void frame_free(frame *f)
{
   size_t i;
   for (i = 0; i < 3; i++) free(f->mesh[i].positions), free(f->mesh[i].normals);
}
static dn_dressed_pose pose_of(wardrobe *w, float bend)
{
   dn_dressed_pose p;
   size_t j;
   memset(&p, 0, sizeof p);
   for (j = 0; j < S; j++) w->theta[3 * j] = 0.1f * bend, w->theta[3 * j + 1] = 0.05f * bend, w->theta[3 * j + 2] = j ? bend * (j % 2 ? 1.0f : 0.7f) : 0.0f;
   p.theta = w->theta, p.strength = 1;
   return p;
}
static float largest(const float *a, const float *b, size_t n)
{
   float most = 0;
   size_t i;
   for (i = 0; i < n; i++) most = fabsf(a[i] - b[i]) > most || a[i] != a[i] ? fabsf(a[i] - b[i]) : most;
   return most;
}

TEST(at_rest_everything_is_as_modelled)
{
   wardrobe w;
   dn_dressed *d;
   dn_dressed_pose p;
   dn_dressed_view v;
   frame f;
   size_t i;
   wardrobe_open(&w, JOINTS | PARENTS | POSE);
   d = dress(&w);
   dn_dressed_describe(d, &v);
   CHECK(v.vertices == w.v[2] && v.joints == S && v.garments == 2 && v.bytes > 0 && v.rig && v.garment[1]);
   CHECK(memcmp(v.rest, w.body_made.rest, 12 * w.v[2]) == 0);
   p = pose_of(&w, 0);
   f = frame_of(&w, d, &p, NULL);
   CHECK(f.result == DN_OK);
   CHECK(largest(f.mesh[2].positions, w.body_made.rest, 3 * w.v[2]) < 1e-6f);
   CHECK(largest(f.mesh[1].positions, w.inner_made.rest, 3 * w.v[1]) < 1e-6f);
   CHECK(largest(f.mesh[0].positions, w.outer_made.rest, 3 * w.v[0]) < 1e-6f);
   for (i = 0; i < 3; i++) CHECK(f.mesh[i].collision.moved == 0 && f.mesh[i].fallback_nodes == 0);
   CHECK(fabsf(f.mesh[2].bounds_max[1] - 1.25f) < 1e-6f && fabsf(f.mesh[0].bounds_min[1] - 0.15f) < 1e-6f);
   for (i = 0; i < w.v[1]; i++) /* normals point outwards */
      CHECK(f.mesh[1].normals[3 * i] * w.inner_made.loose[3 * i] + f.mesh[1].normals[3 * i + 2] * w.inner_made.loose[3 * i + 2] > 0.99f);
   frame_free(&f);
   dn_dressed_free(d);
   dn_dressed_free(NULL);
   wardrobe_close(&w);
}
/* the body by hand: evaluate, pose offsets, kinematics, LBS */
static void body_by_hand(const wardrobe *w, const float *theta, const float *translation, float *out, float *palette)
{
   dn_shape_view s;
   float *rest, joints[3 * S], offsets[3 * S], rotations[9 * S], inverse[12 * S];
   size_t j, k;
   dn_shape_describe(w->body, &s);
   rest = (float *)test_block(12 * s.vertices);
   dn_shape_evaluate(w->body, w->beta, B, 0, rest, joints, NULL);
   memset(inverse, 0, sizeof inverse);
   for (j = 0; j < S; j++) {
      dn_rodrigues(theta + 3 * j, rotations + 9 * j);
      for (k = 0; k < 3; k++) {
         offsets[3 * j + k] = joints[3 * j + k] - (j ? joints[3 * (j - 1) + k] : 0.0f);
         inverse[12 * j + 5 * k] = 1, inverse[12 * j + 4 * k + 3] = -joints[3 * j + k];
      }
   }
   for (k = 0; k < 3; k++) offsets[k] += translation[k];
   dn_shape_pose_offsets(w->body, rotations, rest, NULL);
   dn_forward_kinematics(s.parents, offsets, rotations, S, palette);
   dn_palette(palette, inverse, S, palette);
   dn_lbs(rest, s.skin_joint, s.skin_weight, s.influences, s.vertices, palette, out);
   free(rest);
}
TEST(a_frame_by_its_parts)
{
   wardrobe w;
   dn_dressed *d;
   dn_dressed_pose p;
   dn_dressed_view v;
   frame f, g;
   float *body, palette[12 * S], rotations[9 * S];
   size_t i, j;
   wardrobe_open(&w, JOINTS | PARENTS | POSE);
   for (i = 0; i < B; i++) w.beta[i] = 0.4f * (float)((i * 7) % 5) - 0.8f;
   w.garment[0].margin = w.garment[1].margin = 0; /* no collision pass */
   d = dress(&w);
   dn_dressed_describe(d, &v);
   p = pose_of(&w, 0.5f);
   p.translation[0] = 0.3f, p.translation[2] = -1.5f;
   f = frame_of(&w, d, &p, NULL);
   body = (float *)test_block(12 * w.v[2]);
   body_by_hand(&w, w.theta, p.translation, body, palette);
   CHECK_MSG(largest(f.mesh[2].positions, body, 3 * w.v[2]) < 2e-6f, "the body is %g off", (double)largest(f.mesh[2].positions, body, 3 * w.v[2]));
   CHECK(largest(f.palette, palette, 12 * S) < 2e-6f);
   for (i = 0; i < 2; i++) {
      dn_garment_pose q;
      dn_garment_output out;
      dn_error e;
      size_t bytes;
      void *scratch = dn_garment_scratch_create(v.garment[i], 1, NULL, &bytes, &e);
      float *positions = (float *)test_block(12 * w.v[i]);
      memset(&q, 0, sizeof q), memset(&out, 0, sizeof out);
      q.palette = f.palette, q.matrix = DN_3X4_ROWS, q.body = f.mesh[2].positions, q.strength = 1, out.positions = positions;
      CHECK(dn_garment_deform(v.garment[i], &q, &out, scratch, bytes, NULL, &e) == DN_OK);
      CHECK(memcmp(positions, f.mesh[i].positions, 12 * w.v[i]) == 0 && f.mesh[i].collision.moved == 0);
      free(positions);
      dn_scratch_free(scratch, bytes, NULL);
   }
   for (j = 0; j < S; j++) dn_rodrigues(w.theta + 3 * j, rotations + 9 * j);
   p.theta = NULL, p.rotations = rotations; /* the same pose as matrices */
   g = frame_of(&w, d, &p, NULL);
   CHECK(f.hash == g.hash);
   free(body);
   frame_free(&f), frame_free(&g);
   dn_dressed_free(d);
   wardrobe_close(&w);
}
TEST(collisions_and_layers)
{
   wardrobe w;
   dn_dressed *d;
   size_t k, moved = 0, checked = 0;
   wardrobe_open(&w, JOINTS | PARENTS);
   d = dress(&w);
   for (k = 0; k < 6; k++) {
      dn_dressed_pose p = pose_of(&w, 0.25f * (float)k);
      dn_parallel par;
      frame f = frame_of(&w, d, &p, NULL), g;
      dn_surface s[2];
      void *memory[2];
      size_t i, squeezed = f.mesh[0].collision.squeezed + f.mesh[1].collision.squeezed;
      memset(&par, 0, sizeof par);
      par.run = backwards, par.workers = 3;
      g = frame_of(&w, d, &p, &par);
      CHECK(f.hash == g.hash && f.result == DN_OK);
      memory[0] = test_aligned(dn_surface_size(w.v[2], w.body_made.t)), memory[1] = test_aligned(dn_surface_size(w.v[1], w.inner_made.t));
      dn_surface_build(&s[0], f.mesh[2].positions, w.v[2], (const uint32_t *)w.body_made.faces, w.body_made.t, memory[0]);
      dn_surface_build(&s[1], f.mesh[1].positions, w.v[1], (const uint32_t *)w.inner_made.faces, w.inner_made.t, memory[1]);
      for (i = 0; squeezed == 0 && i < w.v[0]; i++, checked++) {
         float under = dn_surface_distance(&s[1], f.mesh[0].positions + 3 * i, NULL, NULL);
         CHECK(dn_surface_distance(&s[0], f.mesh[0].positions + 3 * i, NULL, NULL) >= 0.0029f);
         CHECK(under >= 0.0029f || under < -0.05f);
      }
      for (i = 0; squeezed == 0 && i < w.v[1]; i++, checked++) CHECK(dn_surface_distance(&s[0], f.mesh[1].positions + 3 * i, NULL, NULL) >= 0.0029f);
      moved += f.mesh[0].collision.moved + f.mesh[1].collision.moved;
      CHECK(f.mesh[2].collision.moved == 0);
      test_aligned_free(memory[0]), test_aligned_free(memory[1]);
      frame_free(&f), frame_free(&g);
   }
   AT_LEAST(moved, 50, "moved");
   AT_LEAST(checked, 1000, "vertices");
   dn_dressed_free(d);
   wardrobe_close(&w);
}
/* a change must give, bit for bit, what creation with the new numbers gives */
static size_t change_is(wardrobe *w, dn_dressed *d, const dn_dressed_changes *c)
{
   size_t bytes = dn_dressed_change_size(d, 1);
   void *scratch = test_aligned(bytes);
   dn_dressed_pose p;
   dn_dressed *fresh;
   frame f, g;
   dn_error e;
   CHECK(dn_dressed_change(d, c, scratch, bytes - 1, &e) == DN_TOO_SMALL);
   CHECK_MSG(dn_dressed_change(d, c, scratch, bytes, &e) == DN_OK, "%s", e.info);
   fresh = dress(w);
   p = pose_of(w, 0.6f);
   p.parameters = w->desc.thetas ? w->parameters : NULL;
   f = frame_of(w, d, &p, NULL), g = frame_of(w, fresh, &p, NULL);
   CHECK_MSG(f.hash == g.hash, "body %g, inner %g, outer %g apart", (double)largest(f.mesh[2].positions, g.mesh[2].positions, 3 * w->v[2]),
             (double)largest(f.mesh[1].positions, g.mesh[1].positions, 3 * w->v[1]), (double)largest(f.mesh[0].positions, g.mesh[0].positions, 3 * w->v[0]));
   frame_free(&f), frame_free(&g);
   dn_dressed_free(fresh);
   test_aligned_free(scratch);
   return 1;
}
static dn_model *model_from(const char *path)
{
   dn_error e;
   dn_model *m = dn_model_load_file(path, NULL, NULL, &e);
   if (!m) fprintf(stderr, "dressed: %s\n", e.info), exit(2);
   return m;
}
TEST(changes_equal_creation)
{
   int with;
   size_t k, n = 0;
   for (with = 0; with < 3; with++) { /* without models; a clothnet on the outer garment; a model on the body as well */
      wardrobe w;
      dn_model *cloth = NULL, *skin = NULL;
      dn_dressed *d;
      dn_dressed_changes c;
      float looseness[2] = {0, 0};
      const float *alpha[2];
      frame f;
      dn_dressed_pose p;
      wardrobe_open(&w, JOINTS | PARENTS | POSE);
      if (with) {
         cloth = model_from("data/golden/clothnet_small.safetensors");
         w.garment[0].refine = cloth, w.garment[0].alpha = w.alpha, w.garment[0].alphas = 3, w.desc.thetas = 72;
      }
      if (with == 2) skin = model_from("data/golden/gat_small.safetensors"), w.desc.refine = skin, w.desc.resolution = 24;
      d = dress(&w);
      p = pose_of(&w, 0.6f), p.parameters = with ? w.parameters : NULL;
      f = frame_of(&w, d, &p, NULL);
      p.strength = 0;
      for (k = 0; k < 1; k++) { /* the models do something */
         frame plain = frame_of(&w, d, &p, NULL);
         CHECK((plain.hash != f.hash) == (with != 0));
         CHECK((largest(plain.mesh[2].positions, f.mesh[2].positions, 3 * w.v[2]) > 0) == (with == 2));
         frame_free(&plain);
      }
      frame_free(&f);
      memset(&c, 0, sizeof c);
      n += change_is(&w, d, &c); /* nothing */
      c.looseness = looseness, looseness[0] = w.garment[0].looseness = 0.02f, n += change_is(&w, d, &c);
      w.beta[0] = 1.5f, w.beta[1] = -0.7f, w.beta[6] = 1, c.looseness = NULL, c.beta = w.beta, c.betas = B, n += change_is(&w, d, &c);
      looseness[1] = w.garment[1].looseness = -0.001f, c.looseness = looseness, w.beta[0] = -1, n += change_is(&w, d, &c);
      memset(w.beta, 0, sizeof w.beta), w.beta[0] = 0.25f, c.betas = 1, n += change_is(&w, d, &c); /* fewer: the others are 0 again */
      if (with) memset(&c, 0, sizeof c), alpha[0] = w.alpha, alpha[1] = NULL, c.alpha = alpha, w.alpha[1] = -0.6f, n += change_is(&w, d, &c);
      dn_dressed_free(d);
      dn_model_free(cloth), dn_model_free(skin);
      wardrobe_close(&w);
   }
   AT_LEAST(n, 17, "changes");
}
TEST(bad_changes_change_nothing)
{
   wardrobe w;
   dn_dressed *d;
   dn_dressed_changes c;
   dn_dressed_pose p;
   float looseness[2], beta[B], *scratch;
   frame f, g;
   size_t bytes, k;
   dn_error e;
   wardrobe_open(&w, JOINTS | PARENTS);
   d = dress(&w);
   bytes = dn_dressed_change_size(d, 1);
   scratch = (float *)test_aligned(bytes);
   p = pose_of(&w, 0.4f);
   f = frame_of(&w, d, &p, NULL);
   for (k = 0; k < 3; k++) {
      memset(&c, 0, sizeof c), memset(beta, 0, sizeof beta);
      looseness[0] = looseness[1] = 0.01f, c.looseness = looseness, c.betas = B;
      if (k == 0) looseness[1] = NAN;
      if (k == 1) c.beta = beta, beta[0] = 2, beta[9] = INFINITY;
      if (k == 2) c.beta = beta, looseness[0] = beta[0] = 3.4e38f; /* finite, and so is the body, but not the garment */
      CHECK(dn_dressed_change(d, &c, scratch, bytes, &e) == (k < 2 ? DN_BAD_VALUE : DN_BAD_MESH) && e.info[0]);
      g = frame_of(&w, d, &p, NULL);
      CHECK(f.hash == g.hash);
      frame_free(&g);
   }
   frame_free(&f);
   test_aligned_free(scratch);
   dn_dressed_free(d);
   wardrobe_close(&w);
}
TEST(turning_the_root_turns_everything)
{
   wardrobe w;
   dn_dressed *d;
   dn_dressed_pose p;
   frame f, g;
   float r[9], moved[3];
   size_t m, i, k;
   wardrobe_open(&w, JOINTS | PARENTS | POSE);
   d = dress(&w);
   p = pose_of(&w, 0.3f);
   memset(w.theta, 0, 3 * sizeof *w.theta);
   f = frame_of(&w, d, &p, NULL);
   w.theta[0] = 0.4f, w.theta[1] = -1.1f, w.theta[2] = 0.2f, p.translation[1] = 2;
   g = frame_of(&w, d, &p, NULL);
   dn_rodrigues(w.theta, r); /* about the root joint, which is the origin here */
   for (m = 0; m < 3; m++)
      for (i = 0; i < w.v[m]; i++) {
         const float *x = f.mesh[m].positions + 3 * i;
         for (k = 0; k < 3; k++) moved[k] = r[3 * k] * x[0] + r[3 * k + 1] * x[1] + r[3 * k + 2] * x[2] + p.translation[k];
         CHECK_MSG(largest(moved, g.mesh[m].positions + 3 * i, 3) < 1e-4f, "mesh %lu, vertex %lu: %g", (unsigned long)m, (unsigned long)i, (double)largest(moved, g.mesh[m].positions + 3 * i, 3));
      }
   frame_free(&f), frame_free(&g);
   dn_dressed_free(d);
   wardrobe_close(&w);
}
static size_t refused(const wardrobe *w, dn_result code, const char *word)
{
   counting c;
   dn_allocator a = counting_allocator(&c, -1);
   dn_error e;
   dn_dressed *d = dn_dressed_create(&w->desc, &a, &e);
   if (CHECK_MSG(!d, "accepted, expected a word on %s", word))
      CHECK_MSG(e.code == code && strstr(e.info, word), "%d: \"%s\", expected %d and \"%s\"", (int)e.code, e.info, (int)code, word);
   dn_dressed_free(d);
   CHECK(c.live == 0 && c.wrong == 0);
   return 1;
}
TEST(refusals_and_allocations)
{
   wardrobe w;
   size_t n = 0;
   long k;
   wardrobe_open(&w, PARENTS), n += refused(&w, DN_UNSUPPORTED, "joints"), wardrobe_close(&w);
   wardrobe_open(&w, JOINTS), n += refused(&w, DN_UNSUPPORTED, "parents"), wardrobe_close(&w);
   wardrobe_open(&w, JOINTS | PARENTS);
   w.beta[3] = NAN, n += refused(&w, DN_BAD_VALUE, "beta 3"), w.beta[3] = 0;
   w.garment[1].looseness = INFINITY, n += refused(&w, DN_BAD_VALUE, "looseness of garment 1"), w.garment[1].looseness = 0;
   w.garment[0].margin = -1, n += refused(&w, DN_BAD_VALUE, "margin of garment 0"), w.garment[0].margin = 0.002f;
   w.garment[0].reach = NAN, n += refused(&w, DN_BAD_VALUE, "reach of garment 0"), w.garment[0].reach = 0;
   w.desc.betas = B + 1, n += refused(&w, DN_BAD_SHAPE, "betas: found 11"), w.desc.betas = B;
   {
      dn_model *cloth = model_from("data/golden/clothnet_small.safetensors");
      w.garment[0].refine = cloth; /* no alphas */
      n += refused(&w, DN_BAD_SHAPE, "alpha");
      w.garment[0].refine = NULL, w.desc.refine = cloth; /* a garment's model on the body */
      n += refused(&w, DN_UNSUPPORTED, "garment");
      w.desc.refine = NULL;
      dn_model_free(cloth);
   }
   for (k = 0; k < 3; k++) { /* the k-th allocation fails: one for the character, one for scratch */
      counting c;
      dn_allocator a = counting_allocator(&c, k);
      dn_error e;
      dn_dressed *d = dn_dressed_create(&w.desc, &a, &e);
      CHECK(k == 2 ? d != NULL : !d && e.code == DN_NO_MEMORY);
      dn_dressed_free(d);
      CHECK(c.live == 0 && c.wrong == 0);
   }
   {
      size_t bytes, scratch_bytes;
      void *memory, *scratch;
      dn_dressed *d;
      dn_error e;
      CHECK(dn_dressed_size(&w.desc, &bytes, &scratch_bytes, &e) == DN_OK);
      memory = test_aligned(bytes), scratch = test_aligned(scratch_bytes);
      CHECK(dn_dressed_init(&w.desc, memory, bytes - 1, scratch, scratch_bytes, &d, &e) == DN_TOO_SMALL && !d && strstr(e.info, "memory"));
      CHECK(dn_dressed_init(&w.desc, memory, bytes, scratch, scratch_bytes - 1, &d, &e) == DN_TOO_SMALL && !d && strstr(e.info, "scratch"));
      CHECK(dn_dressed_init(&w.desc, memory, bytes, scratch, scratch_bytes, &d, &e) == DN_OK && d);
      dn_dressed_free(d); /* nothing: the memory is ours */
      test_aligned_free(memory), test_aligned_free(scratch);
   }
   w.desc.garments = 0; /* nobody is forced to dress */
   {
      dn_dressed *d = dress(&w);
      dn_dressed_pose p = pose_of(&w, 0.5f);
      size_t bytes = dn_dressed_scratch_size(d, 1);
      void *scratch = test_aligned(bytes);
      float *positions = (float *)test_block(20 * w.v[2]), *body = (float *)test_block(12 * w.v[2]), palette[12 * S];
      dn_dressed_mesh mesh;
      size_t i;
      memset(&mesh, 0, sizeof mesh);
      mesh.positions = positions, mesh.position_stride = 20; /* interleaved with something of the caller's */
      CHECK(dn_dressed_deform(d, &p, &mesh, NULL, NULL, scratch, bytes, NULL, NULL) == DN_OK);
      body_by_hand(&w, w.theta, p.translation, body, palette);
      for (i = 0; i < w.v[2]; i++) CHECK(largest(positions + 5 * i, body + 3 * i, 3) < 2e-6f);
      CHECK(dn_dressed_deform(d, &p, NULL, NULL, NULL, scratch, bytes, NULL, NULL) == DN_OK);
      w.theta[4] = NAN; /* a pose that is not finite: said, written, survived */
      CHECK(dn_dressed_deform(d, &p, &mesh, NULL, NULL, scratch, bytes, NULL, NULL) == DN_NOT_FINITE);
      free(positions), free(body);
      test_aligned_free(scratch);
      dn_dressed_free(d);
   }
   AT_LEAST(n, 9, "refusals");
   wardrobe_close(&w);
}

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(at_rest_everything_is_as_modelled);
   RUN(a_frame_by_its_parts);
   RUN(collisions_and_layers);
   RUN(changes_equal_creation);
   RUN(bad_changes_change_nothing);
   RUN(turning_the_root_turns_everything);
   RUN(refusals_and_allocations);
   return TEST_END();
}
