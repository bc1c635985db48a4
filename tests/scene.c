/*  scene.c - the examples' files: safetensors in and out, characters, motions, bare meshes, baked animations, and glTF

    Alone (by the Makefile) it is built without a glTF reader; scene.sh builds it once more with tinygltf and then
    every glTF case runs too. All files are made here. */
#include "../examples/common/tensors.c"
#define say scene_say /* the two files have helpers of the same name */
#define copy_text scene_copy_text
#include "../examples/common/scene.c"
#undef say
#undef copy_text
#include "../examples/common/glb.c"
#include "../examples/common/mesh.c"
#define identity retarget_identity
#include "../examples/common/retarget.c"
#undef identity
#include "test.h"

static char error[EX_ERROR], folder[64];
static const char *file(const char *name) /* one of a few names in the test's folder */
{
   static char path[4][128];
   static int at;
   at = (at + 1) % 4;
   snprintf(path[at], sizeof path[at], "%s-%s", folder, name);
   return path[at];
}
static void save(const char *path, const void *data, size_t size)
{
   FILE *f = fopen(path, "wb");
   if (!f || fwrite(data, 1, size, f) != size || fclose(f)) { fprintf(stderr, "cannot write %s\n", path); exit(2); }
}
/* a refusal is NULL and one line that begins with the file's name */
static int refused(const void *object, const char *path)
{
   return !object && !strncmp(error, path, strlen(path)) && strlen(error) > strlen(path) + 5 && !strchr(error, '\n') && strlen(error) < EX_ERROR;
}

/* ------------------------------------------------- safetensors */
TEST(tensors_come_back)
{
   static const float f[6] = {1, 2, 3, 4, 5, 6};
   static const uint8_t u[3] = {7, 8, 9};
   static const int32_t n[2] = {-1, 5};
   size_t six[2] = {3, 2}, three[1] = {3}, two[1] = {2}, bad[2] = {3, 3}, any[2] = {0, 2};
   const char *path = file("a.safetensors");
   const ex_tensor *t;
   ex_tensors *r;
   ex_writer *w = ex_writer_open(path, error);
   size_t a, b, c;
   uint32_t out[3];
   if (!CHECK(w != NULL)) return;
   ex_writer_meta(w, "quote", "a \"b\" \\ \n end");
   ex_writer_metaf(w, "number", "%d", 42);
   b = ex_writer_tensor(w, "bytes", EX_U8, 1, three); /* before the floats: the writer must order by size */
   a = ex_writer_tensor(w, "floats", EX_F32, 2, six);
   c = ex_writer_tensor(w, "ints", EX_I32, 1, two);
   ex_writer_put(w, a, 2, f + 2, 4); /* out of order, in pieces */
   ex_writer_put(w, c, 0, n, 2);
   ex_writer_put(w, a, 0, f, 2);
   ex_writer_put(w, b, 0, u, 3);
   CHECK(ex_writer_close(w, error));
   r = ex_tensors_open(path, error);
   if (!CHECK_MSG(r != NULL, "%s", error)) return;
   CHECK(ex_tensors_count(r) == 3);
   CHECK(!strcmp(ex_tensors_meta(r, "quote"), "a \"b\" \\ \n end") && !strcmp(ex_tensors_meta(r, "number"), "42") && !ex_tensors_meta(r, "none"));
   t = ex_tensors_get(r, "floats", 2, six, error);
   CHECK(t && !memcmp(t->data, f, sizeof f) && (uintptr_t)t->data % 4 == 0);
   CHECK(ex_tensors_get(r, "floats", 2, any, error) == t);
   CHECK(refused(ex_tensors_get(r, "floats", 2, bad, error), path) && strstr(error, "[3,2]") && strstr(error, "[3,3]"));
   CHECK(refused(ex_tensors_get(r, "nothing", 2, bad, error), path));
   t = ex_tensors_find(r, "bytes");
   CHECK(t && ex_tensor_u32(r, t, out, error) && out[0] == 7 && out[2] == 9);
   t = ex_tensors_find(r, "ints");
   CHECK(t && !ex_tensor_u32(r, t, out, error) && strstr(error, "-1")); /* no index */
   ex_tensors_close(r);
   remove(path);
}
TEST(writer_leaves_no_half_file)
{
   size_t two[1] = {2};
   float x[3] = {1, 2, 3};
   const char *path = file("b.safetensors");
   ex_writer *w = ex_writer_open(path, error);
   size_t id;
   FILE *f;
   if (!CHECK(w != NULL)) return;
   id = ex_writer_tensor(w, "x", EX_F32, 1, two);
   ex_writer_put(w, id, 0, x, 3); /* one too many */
   CHECK(!ex_writer_close(w, error) && strstr(error, path));
   f = fopen(path, "rb");
   CHECK(f == NULL);
   if (f) fclose(f);
   CHECK(refused(ex_writer_open(file("no/such/folder.safetensors"), error), folder));
}
TEST(hostile_safetensors)
{
   static const char *const head[] = {
      "", "{", "[]", "{}x\"", "{\"a\"", "{\"a\":}", "{\"a\":{}}", "{\"a\":{\"dtype\":\"F32\"}}",
      "{\"a\":{\"dtype\":\"F99\",\"shape\":[1],\"data_offsets\":[0,4]}}",
      "{\"a\":{\"dtype\":\"F32\",\"shape\":[2],\"data_offsets\":[0,4]}}",
      "{\"a\":{\"dtype\":\"F32\",\"shape\":[1],\"data_offsets\":[4,0]}}",
      "{\"a\":{\"dtype\":\"F32\",\"shape\":[4],\"data_offsets\":[0,16]}}",
      "{\"a\":{\"dtype\":\"F32\",\"shape\":[-1],\"data_offsets\":[0,4]}}",
      "{\"a\":{\"dtype\":\"F32\",\"shape\":[1,1,1,1,1,1,1,1,1],\"data_offsets\":[0,4]}}",
      "{\"a\":{\"dtype\":\"F32\",\"shape\":[4294967296,4294967296],\"data_offsets\":[0,0]}}",
      "{\"a\":{\"dtype\":\"F32\",\"shape\":[99999999999999999999999],\"data_offsets\":[0,4]}}",
      "{\"a\":{\"dtype\":\"F32\",\"dtype\":\"F32\",\"shape\":[1],\"data_offsets\":[0,4]}}",
      "{\"a\":{\"dtype\":\"F32\",\"shape\":[1],\"data_offsets\":[0,4]},\"a\":{\"dtype\":\"F32\",\"shape\":[1],\"data_offsets\":[0,4]}}",
      "{\"__metadata__\":{\"a\":1}}", "{\"__metadata__\":{\"a\":\"\\u12\"}}", "{\"__metadata__\":{\"a\":\"\\q\"}}"
   };
   const char *path = file("c.safetensors");
   size_t i, k, refusals = 0;
   for (i = 0; i < sizeof head / sizeof *head; i++) {
      unsigned char raw[512];
      size_t n = strlen(head[i]);
      ex_tensors *r;
      memset(raw, 0, sizeof raw);
      raw[0] = (unsigned char)n;
      memcpy(raw + 8, head[i], n);
      save(path, raw, 8 + n + 8);
      r = ex_tensors_open(path, error);
      refusals += (size_t)CHECK_MSG(refused(r, path), "accepted: %s", head[i]);
      ex_tensors_close(r);
   }
   { /* every prefix of a good file */
      static const char good[] = "{\"__metadata__\":{\"k\":\"\\u00e9\\ud83d\\ude00\"},\"a\":{\"dtype\":\"U8\",\"shape\":[1],\"data_offsets\":[0,1]},\"b\":{\"dtype\":\"F32\",\"shape\":[1],\"data_offsets\":[1,5]}}";
      unsigned char raw[512] = {0};
      size_t n = sizeof good - 1;
      raw[0] = (unsigned char)n;
      memcpy(raw + 8, good, n);
      for (k = 0; k <= 8 + n + 5; k++) {
         ex_tensors *r;
         save(path, raw, k);
         r = ex_tensors_open(path, error);
         if (k == 8 + n + 5) {
            CHECK_MSG(r != NULL, "%s", error);
            CHECK(r && (uintptr_t)ex_tensors_find(r, "b")->data % 4 == 0); /* one byte off in the file */
            CHECK(r && !strcmp(ex_tensors_meta(r, "k"), "\xc3\xa9\xf0\x9f\x98\x80"));
         } else refusals += (size_t)CHECK_MSG(refused(r, path), "accepted %lu bytes", (unsigned long)k);
         ex_tensors_close(r);
      }
   }
   AT_LEAST(refusals, 100, "refusals");
   remove(path);
}

/* ------------------------------------------------- a character in memory: a strip of two joints along y */
enum { V = 6, T = 4, S = 2 };
static const float strip[V][3] = {{0, 1, 0}, {0.5f, 1, 0}, {0, 2, 0}, {0.5f, 2, 0}, {0, 3, 0}, {0.5f, 3, 0}};
static const uint32_t faces[T][3] = {{0, 1, 2}, {2, 1, 3}, {2, 3, 4}, {4, 3, 5}};
typedef struct parts { int32_t triangle[T][3], joint[V][2], parent[S]; float weight[V][2], rest[S][3], position[V][3]; const char *names; } parts;
static parts good_parts(void)
{
   parts p;
   int i;
   memset(&p, 0, sizeof p);
   for (i = 0; i < 3 * T; i++) p.triangle[i / 3][i % 3] = (int32_t)faces[i / 3][i % 3];
   memcpy(p.position, strip, sizeof strip);
   for (i = 0; i < V; i++) { p.joint[i][0] = 0; p.joint[i][1] = 1; p.weight[i][0] = i < 2 ? 1 : i < 4 ? 0.5f : 0; p.weight[i][1] = 1 - p.weight[i][0]; }
   p.parent[0] = -1;
   p.rest[0][1] = 1;
   p.rest[1][1] = 2;
   p.names = "rig:hip, rig:knee";
   return p;
}
static ex_scene *through_file(const parts *p, const char *path)
{
   size_t v3[2] = {V, 3}, t3[2] = {T, 3}, v2[2] = {V, 2}, s3[2] = {S, 3};
   ex_writer *w = ex_writer_open(path, error);
   size_t id[6];
   if (p->names) ex_writer_meta(w, "joint_names", p->names);
   id[0] = ex_writer_tensor(w, "positions", EX_F32, 2, v3);
   id[1] = ex_writer_tensor(w, "triangles", EX_I32, 2, t3);
   id[2] = ex_writer_tensor(w, "skin_joints", EX_I32, 2, v2);
   id[3] = ex_writer_tensor(w, "skin_weights", EX_F32, 2, v2);
   id[4] = ex_writer_tensor(w, "joint_rest", EX_F32, 2, s3);
   id[5] = ex_writer_tensor(w, "parents", EX_I32, 1, s3);
   ex_writer_put(w, id[0], 0, p->position, 3 * V);
   ex_writer_put(w, id[1], 0, p->triangle, 3 * T);
   ex_writer_put(w, id[2], 0, p->joint, 2 * V);
   ex_writer_put(w, id[3], 0, p->weight, 2 * V);
   ex_writer_put(w, id[4], 0, p->rest, 3 * S);
   ex_writer_put(w, id[5], 0, p->parent, S);
   if (!ex_writer_close(w, error)) { fprintf(stderr, "%s\n", error); exit(2); }
   return ex_scene_load(path, error);
}
static int near(const float *a, const float *b, size_t n, float most)
{
   size_t i;
   for (i = 0; i < n; i++) if (!(fabsf(a[i] - b[i]) <= most)) return 0;
   return 1;
}
TEST(character_safetensors)
{
   parts p = good_parts();
   const char *path = file("d.safetensors"), *again = file("e.safetensors");
   ex_scene *s = through_file(&p, path), *r;
   float palette[S][12], local[S][10], skinned[V][3], want[3] = {-1, 2, 0};
   if (!CHECK_MSG(s != NULL, "%s", error)) return;
   CHECK(s->vertices == V && s->triangles == T && s->joints == S && s->influences == 2 && s->parents[1] == 0);
   CHECK(!memcmp(s->positions, strip, sizeof strip) && !memcmp(s->triangle, faces, sizeof faces));
   CHECK(!strcmp(s->names[1], "rig:knee") && !strcmp(ex_short_name(s->names[1]), "knee") && !strcmp(ex_short_name("a|b:c"), "c") && !strcmp(ex_short_name("end:"), "end:"));
   ex_pose_local(s, NULL, palette[0]);
   ex_skin(s, palette[0], skinned[0]);
   CHECK(near(skinned[0], strip[0], 3 * V, 1e-6f)); /* the rest pose is the rest mesh */
   memcpy(local, s->rest, sizeof local);
   local[1][5] = local[1][6] = 0.70710678f; /* knee by 90 degrees about z: (0,3,0) goes to (-1,2,0) */
   ex_pose_local(s, local[0], palette[0]);
   ex_skin(s, palette[0], skinned[0]);
   CHECK(near(skinned[4], want, 3, 1e-6f) && near(skinned[0], strip[0], 6, 1e-6f));
   CHECK(near(s->normals, (const float[3]){0, 0, 1}, 3, 1e-6f));
   CHECK_MSG(ex_scene_save(s, again, error), "%s", error);
   r = ex_scene_load(again, error);
   CHECK(r && r->joints == S && !memcmp(r->inverse_bind, s->inverse_bind, 12 * S * sizeof(float)) && !memcmp(r->rest, s->rest, 10 * S * sizeof(float)) && !strcmp(r->names[0], "rig:hip"));
   ex_scene_free(r);
   ex_scene_free(s);
   remove(path);
   remove(again);
}
TEST(joints_in_any_order)
{
   parts p = good_parts();
   const char *path = file("f.safetensors");
   ex_scene *s;
   int i;
   p.parent[0] = 1; /* the child first */
   p.parent[1] = -1;
   p.rest[0][1] = 2;
   p.rest[1][1] = 1;
   for (i = 0; i < V; i++) { p.joint[i][0] = 1; p.joint[i][1] = 0; }
   p.names = "rig:knee,rig:hip";
   s = through_file(&p, path);
   if (!CHECK_MSG(s != NULL, "%s", error)) return;
   CHECK(s->parents[0] == -1 && s->parents[1] == 0 && !strcmp(s->names[0], "rig:hip") && s->joint_rest[1] == 1 && s->joint_rest[4] == 2);
   CHECK(s->skin_joints[0] == 0 && s->skin_joints[2 * V - 1] == 1 && s->inverse_bind[12 + 7] == -2);
   ex_scene_free(s);
   p.parent[1] = 0; /* a circle */
   CHECK(refused(through_file(&p, path), path) && strstr(error, "circle"));
   remove(path);
}
TEST(characters_that_are_wrong)
{
   const char *path = file("g.safetensors");
   uint32_t nan = 0x7fc00000u;
   size_t i, n = 0;
   for (i = 0; i < 9; i++) {
      parts p = good_parts();
      ex_scene *s;
      switch (i) {
      case 0: p.triangle[1][1] = V; break;
      case 1: p.triangle[0][0] = -1; break;
      case 2: p.joint[2][1] = S; break;
      case 3: p.parent[1] = 5; break;
      case 4: memcpy(&p.position[3][2], &nan, 4); break;
      case 5: memcpy(&p.weight[3][1], &nan, 4); break;
      case 6: memcpy(&p.rest[1][0], &nan, 4); break;
      case 7: p.names = "only one"; break;
      default: p.names = NULL; break;
      }
      s = through_file(&p, path);
      n += (size_t)CHECK_MSG(refused(s, path), "case %lu accepted or not said: %s", (unsigned long)i, error);
      ex_scene_free(s);
   }
   AT_LEAST(n, 9, "refusals");
   CHECK(refused(ex_scene_load(file("none.safetensors"), error), folder));
   CHECK(refused(ex_scene_load(file("x.fbx"), error), folder));
   { /* a zero weight may name any joint */
      parts p = good_parts();
      ex_scene *s;
      p.joint[0][1] = 200;
      s = through_file(&p, path);
      CHECK_MSG(s && s->skin_joints[1] == 0, "%s", error);
      ex_scene_free(s);
   }
   remove(path);
}
TEST(motion_by_palettes)
{
   parts p = good_parts();
   const char *path = file("h.safetensors"), *motion = file("i.safetensors");
   ex_scene *s = through_file(&p, path);
   size_t shape[4] = {3, S, 3, 4}, k, id;
   float x[3 * S * 12], got[S * 12];
   ex_writer *w = ex_writer_open(motion, error);
   ex_motion *m;
   for (k = 0; k < sizeof x / sizeof *x; k++) x[k] = (float)k;
   ex_writer_meta(w, "fps", "15");
   id = ex_writer_tensor(w, "palettes", EX_F32, 4, shape);
   ex_writer_put(w, id, 0, x, sizeof x / sizeof *x);
   CHECK(ex_writer_close(w, error));
   m = ex_motion_load(motion, NULL, s, error);
   if (CHECK_MSG(m != NULL, "%s", error)) {
      ex_pose(s, m, 2, got);
      CHECK(m->frames == 3 && m->fps == 15 && !memcmp(got, x + 2 * S * 12, sizeof got));
   }
   ex_motion_free(m);
   CHECK(refused(ex_motion_load(path, NULL, s, error), path)); /* a character is no motion */
   shape[1] = S + 1;
   w = ex_writer_open(motion, error);
   ex_writer_tensor(w, "palettes", EX_F32, 4, shape);
   CHECK(ex_writer_close(w, error));
   CHECK(refused(ex_motion_load(motion, NULL, s, error), motion)); /* another skeleton */
   ex_scene_free(s);
   remove(path);
   remove(motion);
}

/* ------------------------------------------------- baked animation */
static uint32_t le32(const unsigned char *p) { return p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24; }
TEST(baked_animation)
{
   const char *path = file("j.glb");
   float x[3][V][3], times[3] = {1, 1.5f, 2.5f}, got;
   ex_baked b;
   unsigned char *raw;
   size_t size, f, i, json;
   for (f = 0; f < 3; f++) for (i = 0; i < 3 * V; i++) x[f][i / 3][i % 3] = strip[i / 3][i % 3] + (i % 3 == 2 ? (float)f : 0);
   memset(&b, 0, sizeof b);
   b.name = "a \"quoted\" name";
   b.vertices = V; b.triangles = T; b.frames = 3; b.triangle = faces[0]; b.positions = x[0][0]; b.times = times;
   if (!CHECK_MSG(ex_write_glb(path, &b, error), "%s", error)) return;
   raw = test_file(path, &size);
   json = le32(raw + 12);
   CHECK(!memcmp(raw, "glTF", 4) && le32(raw + 8) == size && 28 + json + le32(raw + 20 + json) == size && json % 4 == 0 && size % 4 == 0);
   raw[20 + json] = 0; /* the next chunk's length: not needed any more */
   CHECK(strstr((char *)raw + 20, "\"targets\":[{\"POSITION\":5,\"NORMAL\":6},{\"POSITION\":7,\"NORMAL\":8}]") && !strstr((char *)raw + 20, "a \"quoted"));
   memcpy(&got, raw + 28 + json + 12 * T + 24 * V + 8, 4); /* the last time, from 0 */
   CHECK(got == 1.5f);
   memcpy(&got, raw + 28 + json + 12 * T + 24 * V + 12 + 24 + 24 * V + 8, 4); /* z of the first vertex's offset at frame 2 */
   CHECK(got == 2);
   free(raw);
   b.frames = 1;
   CHECK_MSG(ex_write_glb(path, &b, error), "%s", error);
   b.frames = 0;
   CHECK(!ex_write_glb(path, &b, error) && strstr(error, path));
   remove(path);
}

/* ------------------------------------------------- OBJ */
static ex_mesh *obj_of(const char *path, const char *text)
{
   save(path, text, strlen(text));
   return ex_mesh_load(path, error);
}
TEST(obj_meshes)
{
   static const struct { const char *text; size_t vertices, triangles; int normals, uv; } good[] = {
      {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3", 3, 1, 0, 0},                              /* no last line end */
      {"# c\r\nv 0 0 0 1\r\nv 1 0 0 .5 .5 .5\r\nv 1 1 0\r\nv 0 1 0\r\ng a\r\nf 1 2 3 4 # quad\r\n", 4, 2, 0, 0},
      {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\n\n\n", 3, 1, 0, 0},                       /* from the end */
      {"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt .25 0.75\nvn 0 0 2\nf 1/1/1 2/2/1 3/1/1\nf 1/1/1 3/1/1 4/2/1\n", 4, 2, 1, 1},
      {"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt .25 0.75\nf 1/1 2/1 3/1\nf 1/2 3/1 4/1\n", 5, 2, 0, 1},  /* a seam at vertex 1 */
      {"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1\n", 3, 1, 1, 0},
      {"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 9 9 9\nvn 0 0 1\nf 1//1 2//1 3\n", 4 - 1, 1, 0, 0},   /* a normal missing: none; vertex 4 unused */
      {"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 0\nf 1//1 2//1 3//1\n", 3, 1, 0, 0}          /* no direction */
   };
   static const char *const bad[][2] = {
      {"", "no faces"}, {"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no faces"}, {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "line 4: a face names a vertex"},
      {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "line 4"}, {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -4 -2 -1\n", "line 4"},
      {"v 0 0 0\nv 1 0 0\nf 1 2\n", "line 3: a face has fewer"}, {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3x\n", "line 4: a corner"},
      {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1 2/1 3/1\n", "texture coordinate"}, {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1//1 2//1 3//1\n", "a normal that is not"},
      {"v 0 0\n", "line 1: has too few"}, {"v 0 0 zero\n", "line 1: is not a list"}, {"v 0 0 nan\n", "line 1"}, {"v 0 0 1e999\n", "line 1"},
      {"v 0 0 1e\n", "line 1"}, {"v 1e20 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "position of vertex 0"},
      {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1/1/1 2 3\n", "line 4"}, {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 99999999999999999999 2 3\n", "line 4"}
   };
   static const char zero_inside[] = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n\0more";
   const char *path = file("o.obj");
   ex_mesh *m;
   size_t i, n = 0;
   for (i = 0; i < sizeof good / sizeof *good; i++) {
      m = obj_of(path, good[i].text);
      if (!CHECK_MSG(m != NULL, "%s", error)) continue;
      CHECK_MSG(m->vertices == good[i].vertices && m->triangles == good[i].triangles && !m->normals == !good[i].normals && !m->uv == !good[i].uv,
                "file %lu: %lu vertices, %lu triangles", (unsigned long)i, (unsigned long)m->vertices, (unsigned long)m->triangles);
      if (m->normals) CHECK(m->normals[2] == 1);
      if (i == 3) CHECK(m->uv[0] == 0 && m->uv[1] == 1 && m->uv[2] == 0.25f && m->uv[3] == 0.25f); /* from the top */
      if (i == 1) CHECK(m->triangle[3] == 0 && m->triangle[4] == 2 && m->triangle[5] == 3);
      ex_mesh_free(m);
   }
   for (i = 0; i < sizeof bad / sizeof *bad; i++, n++) {
      m = obj_of(path, bad[i][0]);
      CHECK_MSG(!m && strstr(error, path) && strstr(error, bad[i][1]), "file %lu: %s", (unsigned long)i, m ? "was read" : error);
      ex_mesh_free(m);
   }
   m = obj_of(path, "v -1.5e-1 +2.25 1234567.875\nv 3.0000001 .1 7e+2\nv 0.3333333432674408 1e-5 9\nf 1 2 3\n");
   CHECK_MSG(m && m->positions[0] == -0.15f && m->positions[1] == 2.25f && m->positions[2] == 1234567.875f && m->positions[3] == 3.0000001f &&
             m->positions[4] == 0.1f && m->positions[5] == 700 && m->positions[6] == 0.3333333432674408f && m->positions[7] == 1e-5f, "%s", error);
   ex_mesh_free(m);
   save(path, zero_inside, sizeof zero_inside);
   CHECK(!ex_mesh_load(path, error) && strstr(error, "zero byte"));
   CHECK(!ex_mesh_load("none.obj", error) && strstr(error, "cannot be opened"));
   CHECK(!ex_mesh_load("none.fbx", error) && strstr(error, "neither .obj"));
   AT_LEAST(n, 15, "wrong OBJ files");
   remove(path);
}

/* ------------------------------------------------- motions for another skeleton */
static const char *const bones[S] = {"Hip", "x|Knee"};
static const int32_t bone_parents[S] = {-1, 0};
TEST(turns_from_axis_angle)
{
   const char *path = file("p.safetensors");
   static const float standing[S][3] = {{0, 1, 0}, {0, 2, 0}}, turn[2][S][3] = {{{0, 0, 0}, {0, 0, 0}}, {{0, 0, 1.57079633f}, {2.0943951f / 1.7320508f, 2.0943951f / 1.7320508f, 2.0943951f / 1.7320508f}}};
   static const float go[2][3] = {{0, 0, 0}, {1, 2, 3}};
   size_t shape[3] = {2, S, 3}, id[2];
   ex_skeleton k;
   ex_turns *t;
   ex_writer *w = ex_writer_open(path, error);
   float q[4];
   k.joints = S, k.names = bones, k.parents = bone_parents, k.rest = standing[0];
   ex_writer_meta(w, "fps", "25");
   id[0] = ex_writer_tensor(w, "axis_angle", EX_F32, 3, shape);
   shape[1] = 3;
   id[1] = ex_writer_tensor(w, "translation", EX_F32, 2, shape);
   ex_writer_put(w, id[0], 0, turn, 2 * S * 3);
   ex_writer_put(w, id[1], 0, go, 6);
   CHECK(ex_writer_close(w, error));
   t = ex_turns_load(path, NULL, &k, error);
   if (!CHECK_MSG(t != NULL, "%s", error)) return;
   CHECK(t->frames == 2 && t->times[1] == 0.04f && t->travel[5] == 3 && t->rotations[0] == 1 && t->rotations[1] == 0);
   CHECK(fabsf(t->rotations[9 * S + 1] + 1) < 1e-6f && fabsf(t->rotations[9 * S + 3] - 1) < 1e-6f); /* 90 degrees about z: x to y */
   CHECK(fabsf(t->rotations[9 * 3 + 2] - 1) < 1e-6f && fabsf(t->rotations[9 * 3 + 3] - 1) < 1e-6f);  /* 120 about (1,1,1): x to y to z */
   ex_quaternion(t->rotations + 9 * 3, q);
   CHECK(fabsf(q[0] - 0.5f) < 1e-6f && fabsf(q[3] - 0.5f) < 1e-6f);
   ex_turns_free(t);
   k.joints = 1;
   CHECK(!ex_turns_load(path, NULL, &k, error) && strstr(error, "axis_angle"));
   remove(path);
}

/* ------------------------------------------------- glTF */
#ifndef EX_TINYGLTF
TEST(gltf_without_a_reader)
{
   const char *path = file("k.glb");
   save(path, "glTF", 4);
   CHECK(refused(ex_scene_load(path, error), path) && strstr(error, "apt-get install libtinygltf-dev"));
   CHECK(!ex_mesh_load(path, error) && strstr(error, "apt-get install libtinygltf-dev"));
   remove(path);
}
#else
/*  The same strip as a GLB: under a node "above" that lifts by 1 and turns nothing, a mesh node whose own transform
    must be ignored, joints listed child first, and an animation: knee LINEAR with keys 0 1 2, hip's travel STEP 0 2,
    scale of the knee CUBICSPLINE 0 1 */
static const char gltf[] =
   "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0,3]}],"
   "\"nodes\":[{\"name\":\"above\",\"translation\":[0,1,0],\"children\":[1]},{\"name\":\"rig:hip\",\"children\":[2]},"
   "{\"name\":\"rig:knee\",\"translation\":[0,1,0]},{\"name\":\"strip\",\"mesh\":0,\"skin\":0,\"translation\":[9,9,9]}],"
   "\"meshes\":[{\"name\":\"strip\",\"primitives\":[{\"attributes\":{\"POSITION\":0,\"JOINTS_0\":1,\"WEIGHTS_0\":2},\"indices\":3}]}],"
   "\"skins\":[{\"joints\":[2,1],\"inverseBindMatrices\":4}],"
   "\"animations\":[{\"name\":\"rig|bend\",\"samplers\":[{\"input\":5,\"output\":6},{\"input\":7,\"output\":8,\"interpolation\":\"STEP\"},{\"input\":9,\"output\":10,\"interpolation\":\"CUBICSPLINE\"}],"
   "\"channels\":[{\"sampler\":0,\"target\":{\"node\":2,\"path\":\"rotation\"}},{\"sampler\":1,\"target\":{\"node\":1,\"path\":\"translation\"}},{\"sampler\":2,\"target\":{\"node\":2,\"path\":\"scale\"}}]}],"
   "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":6,\"type\":\"VEC3\",\"min\":[0,1,0],\"max\":[0.5,3,0]},"
   "{\"bufferView\":1,\"componentType\":5121,\"count\":6,\"type\":\"VEC4\"},{\"bufferView\":2,\"componentType\":5121,\"normalized\":true,\"count\":6,\"type\":\"VEC4\"},"
   "{\"bufferView\":3,\"componentType\":5123,\"count\":12,\"type\":\"SCALAR\"},{\"bufferView\":4,\"componentType\":5126,\"count\":2,\"type\":\"MAT4\"},"
   "{\"bufferView\":5,\"componentType\":5126,\"count\":3,\"type\":\"SCALAR\",\"min\":[0],\"max\":[2]},{\"bufferView\":6,\"componentType\":5126,\"count\":3,\"type\":\"VEC4\"},"
   "{\"bufferView\":7,\"componentType\":5126,\"count\":2,\"type\":\"SCALAR\",\"min\":[0],\"max\":[2]},{\"bufferView\":8,\"componentType\":5126,\"count\":2,\"type\":\"VEC3\"},"
   "{\"bufferView\":9,\"componentType\":5126,\"count\":2,\"type\":\"SCALAR\",\"min\":[0],\"max\":[1]},{\"bufferView\":10,\"componentType\":5126,\"count\":6,\"type\":\"VEC3\"}],"
   "\"bufferViews\":[{\"buffer\":0,\"byteOffset\":0,\"byteLength\":72},{\"buffer\":0,\"byteOffset\":72,\"byteLength\":24},{\"buffer\":0,\"byteOffset\":96,\"byteLength\":24},"
   "{\"buffer\":0,\"byteOffset\":120,\"byteLength\":24},{\"buffer\":0,\"byteOffset\":144,\"byteLength\":128},{\"buffer\":0,\"byteOffset\":272,\"byteLength\":12},"
   "{\"buffer\":0,\"byteOffset\":284,\"byteLength\":48},{\"buffer\":0,\"byteOffset\":332,\"byteLength\":8},{\"buffer\":0,\"byteOffset\":340,\"byteLength\":24},"
   "{\"buffer\":0,\"byteOffset\":364,\"byteLength\":8},{\"buffer\":0,\"byteOffset\":372,\"byteLength\":72}],\"buffers\":[{\"byteLength\":444}]}";
static size_t make_glb(unsigned char *out, const char *json) /* its size */
{
   unsigned char bin[444];
   static const float bend[3][4] = {{0, 0, 0, 1}, {0, 0, 0.70710678f, 0.70710678f}, {0, 0, 0, 1}}, travel[2][3] = {{0, 0, 0}, {0, 0, 3}};
   static const float times[7] = {0, 1, 2, 0, 2, 0, 1}, grow[6][3] = {{0, 0, 0}, {1, 1, 1}, {0, 0, 0}, {0, 0, 0}, {3, 1, 1}, {0, 0, 0}};
   float bind[2][16];
   size_t n = strlen(json), padded = (n + 3) & ~(size_t)3, i;
   memset(bind, 0, sizeof bind);
   for (i = 0; i < 4; i++) bind[0][5 * i] = bind[1][5 * i] = 1;
   bind[0][13] = -2; /* knee, then hip: as the skin lists them */
   bind[1][13] = -1;
   memset(bin, 0, sizeof bin);
   memcpy(bin, strip, 72);
   for (i = 0; i < V; i++) { unsigned char w = i < 2 ? 0 : i < 4 ? 128 : 255; bin[72 + 4 * i] = 0; bin[72 + 4 * i + 1] = 1; bin[96 + 4 * i] = w; bin[96 + 4 * i + 1] = (unsigned char)(255 - w); }
   for (i = 0; i < 12; i++) bin[120 + 2 * i] = (unsigned char)faces[i / 3][i % 3];
   memcpy(bin + 144, bind, 128);
   memcpy(bin + 272, times, 12);
   memcpy(bin + 284, bend, 48);
   memcpy(bin + 332, times + 3, 8);
   memcpy(bin + 340, travel, 24);
   memcpy(bin + 364, times + 5, 8);
   memcpy(bin + 372, grow, 72);
   memcpy(out, "glTF\2\0\0\0", 8);
   for (i = 0; i < 4; i++) {
      out[8 + i] = (unsigned char)((28 + padded + sizeof bin) >> 8 * i);
      out[12 + i] = (unsigned char)(padded >> 8 * i);
      out[20 + padded + i] = (unsigned char)(sizeof bin >> 8 * i);
   }
   memcpy(out + 16, "JSON", 4);
   memset(out + 20, ' ', padded);
   memcpy(out + 20, json, n);
   memcpy(out + 24 + padded, "BIN\0", 4);
   memcpy(out + 28 + padded, bin, sizeof bin);
   return 28 + padded + sizeof bin;
}
static unsigned char room[16384];
static const char *edited(const char *from, const char *to) /* the JSON with one passage replaced */
{
   static char json[12288];
   const char *at = strstr(gltf, from);
   if (!at) { fprintf(stderr, "no %s in the test's glTF\n", from); exit(2); }
   snprintf(json, sizeof json, "%.*s%s%s", (int)(at - gltf), gltf, to, at + strlen(from));
   return json;
}
TEST(gltf_character_and_motion)
{
   const char *path = file("l.glb");
   ex_scene *s;
   ex_motion *m;
   float palette[S][12], x[V][3], lifted[3] = {0, 3, 0};
   save(path, room, make_glb(room, gltf));
   s = ex_scene_load(path, error);
   if (!CHECK_MSG(s != NULL, "%s", error)) return;
   CHECK(s->vertices == V && s->triangles == T && s->joints == S && s->influences == 4 && s->ranges == 1 && s->meshes_left_out == 0);
   CHECK(!memcmp(s->positions, strip, sizeof strip) && !memcmp(s->triangle, faces, sizeof faces));
   CHECK(!strcmp(s->names[0], "rig:hip") && s->parents[1] == 0 && s->joint_rest[1] == 1 && s->joint_rest[4] == 2); /* put in order */
   CHECK(s->above[7] == 1 && s->above[12 + 7] == 0);
   CHECK(fabsf(s->skin_weights[8] - 128 / 255.0f) < 1e-6f && s->skin_joints[8] == 1 && s->skin_joints[9] == 0);
   ex_pose_local(s, NULL, palette[0]);
   ex_skin(s, palette[0], x[0]);
   CHECK(near(x[0], strip[0], 3 * V, 1e-6f)); /* "above" counts, the mesh node's own (9,9,9) does not */
   m = ex_motion_load(path, NULL, s, error);
   if (!CHECK_MSG(m != NULL, "%s", error)) return;
   CHECK(m->frames == 3 && fabsf(m->fps - 1) < 1e-6f && m->joints_matched == 2 && !strcmp(m->name, "rig|bend")); /* key times 0, 1, 2 */
   CHECK(m->local[10 * 3 + 7] == 3 && m->local[10 * 1 + 7] == 1);           /* cubic: the keys themselves */
   CHECK(m->local[10 * 2 + 2] == 0 && m->local[10 * 4 + 2] == 3);           /* step: still 0 at 1, then 3 */
   ex_pose(s, m, 1, palette[0]);
   ex_skin(s, palette[0], x[0]);
   lifted[0] = -1; lifted[1] = 2; lifted[2] = 0;
   CHECK(near(x[4], lifted, 3, 1e-5f)); /* the knee bent by 90 degrees */
   ex_motion_free(m);
   m = ex_motion_load(path, "bend", s, error); /* prefix ignored */
   CHECK(m != NULL);
   ex_motion_free(m);
   m = ex_motion_load(path, "0", s, error);
   CHECK(m != NULL);
   ex_motion_free(m);
   CHECK(refused(ex_motion_load(path, "walk", s, error), path) && strstr(error, "bend"));
   ex_scene_free(s);
   { /* a body half as tall, with other prefixes: the same clip, the travel halved */
      parts p = good_parts();
      const char *small = file("m.safetensors");
      p.names = "Armature|hip,Armature|knee";
      p.rest[0][1] = 0.5f;
      p.rest[1][1] = 1;
      s = through_file(&p, small);
      m = s ? ex_motion_load(path, NULL, s, error) : NULL;
      CHECK_MSG(m && m->joints_matched == 2 && m->local[10 * 4 + 2] == 1.5f && m->local[10 * 4 + 1] == 0.5f, "%s", error);
      ex_motion_free(m);
      ex_scene_free(s);
      p.names = "a,b";
      s = through_file(&p, small);
      CHECK(s && refused(ex_motion_load(path, NULL, s, error), path) && strstr(error, "no joint"));
      ex_scene_free(s);
      remove(small);
   }
   remove(path);
}
TEST(gltf_turns)
{
   const char *path = file("q.glb");
   static const float standing[S][3] = {{0, 1, 0}, {0, 2, 0}}, lying[S][3] = {{0, 1, 0}, {1, 1, 0}};
   ex_skeleton k;
   ex_turns *t;
   save(path, room, make_glb(room, gltf));
   k.joints = S, k.names = bones, k.parents = bone_parents, k.rest = standing[0];
   t = ex_turns_load(path, NULL, &k, error);
   if (!CHECK_MSG(t != NULL, "%s", error)) return;
   CHECK(t->frames == 3 && t->matched == 2 && t->bridged == 0 && !strcmp(t->name, "bend") && t->times[2] == 2);
   CHECK(fabsf(t->rotations[9 * 2] - 1) < 1e-6f && fabsf(t->rotations[9 * 3 + 1] + 1) < 1e-6f); /* hip still, knee by 90 degrees */
   CHECK(fabsf(t->travel[8] - 3) < 1e-6f && t->travel[5] == 0);
   ex_turns_free(t);
   k.rest = lying[0]; /* its bone points along x, the clip's along y: the hip brings it there, the knee bends as before */
   t = ex_turns_load(path, "bend", &k, error);
   if (!CHECK_MSG(t != NULL, "%s", error)) return;
   CHECK(t->bridged == 1 && fabsf(t->rotations[1] + 1) < 1e-6f && fabsf(t->rotations[3] - 1) < 1e-6f && fabsf(t->rotations[9] - 1) < 1e-6f);
   CHECK(fabsf(t->rotations[9 * 2 + 1] + 1) < 1e-6f && fabsf(t->rotations[9 * 3 + 1] + 1) < 1e-6f && fabsf(t->rotations[9 * 5] - 1) < 1e-6f);
   ex_turns_free(t);
   { /* a file whose nodes rest turned: only what moves away from that counts */
      save(path, room, make_glb(room, edited("{\"name\":\"rig:knee\",", "{\"name\":\"rig:knee\",\"rotation\":[0,0,0.70710678,0.70710678],")));
      k.rest = standing[0];
      t = ex_turns_load(path, NULL, &k, error);
      CHECK_MSG(t && fabsf(t->rotations[9 + 1] - 1) < 1e-5f && fabsf(t->rotations[9 * 3] - 1) < 1e-5f, "%s", error); /* keys 0: back by 90; 1: at rest */
      ex_turns_free(t);
   }
   k.names = bones + 1, k.joints = 1;
   t = ex_turns_load(path, NULL, &k, error);
   CHECK_MSG(t && t->matched == 1 && fabsf(t->travel[8] - 3) < 1e-6f, "%s", error); /* the knee alone: it goes where the hip carries it */
   ex_turns_free(t);
   {
      static const char *const other[1] = {"tail"};
      k.names = other;
      CHECK(!ex_turns_load(path, NULL, &k, error) && strstr(error, "moves no joint"));
      CHECK(!ex_turns_load(path, "walk", &k, error) && strstr(error, "bend"));
   }
   remove(path);
}
TEST(gltf_meshes)
{
   const char *path = file("r.glb");
   ex_mesh *m;
   size_t i;
   save(path, room, make_glb(room, gltf));
   m = ex_mesh_load(path, error); /* a skinned mesh: as stored */
   CHECK_MSG(m && m->vertices == V && m->triangles == T && m->skinned == 1 && !m->normals && !m->uv && !memcmp(m->positions, strip, sizeof strip) && !memcmp(m->triangle, faces, sizeof faces), "%s", error);
   ex_mesh_free(m);
   save(path, room, make_glb(room, edited("\"skin\":0,\"translation\":[9,9,9]", "\"translation\":[9,0,-1],\"rotation\":[0,0,0.70710678,0.70710678],\"scale\":[1,1,2]")));
   m = ex_mesh_load(path, error); /* a bare one: where its node puts it */
   if (CHECK_MSG(m && m->skinned == 0, "%s", error))
      for (i = 0; i < V; i++) {
         float want[3];
         want[0] = 9 - strip[i][1], want[1] = strip[i][0], want[2] = 2 * strip[i][2] - 1;
         CHECK(near(m->positions + 3 * i, want, 3, 1e-5f));
      }
   ex_mesh_free(m);
   save(path, room, make_glb(room, edited("\"skin\":0,\"translation\":[9,9,9]", "\"scale\":[-1,1,1]")));
   m = ex_mesh_load(path, error); /* mirrored: the triangles turn, so that their outside stays outside */
   CHECK_MSG(m && m->positions[0] == -strip[0][0] && m->triangle[1] == faces[0][2] && m->triangle[2] == faces[0][1], "%s", error);
   ex_mesh_free(m);
   save(path, room, make_glb(room, edited("\"scenes\":[{\"nodes\":[0,3]}]", "\"scenes\":[{\"nodes\":[0]}]")));
   CHECK(!ex_mesh_load(path, error) && strstr(error, "no mesh in its scene"));
   save(path, room, make_glb(room, edited("\"POSITION\":0", "\"POSITION\":99")));
   CHECK(!ex_mesh_load(path, error) && strstr(error, "99"));
   save(path, room, make_glb(room, edited("\"mesh\":0,\"skin\":0", "\"mesh\":7,\"skin\":0")));
   CHECK(!ex_mesh_load(path, error) && strstr(error, path));
   remove(path);
}
TEST(gltf_variants)
{
   const char *path = file("n.glb");
   ex_scene *s;
   save(path, room, make_glb(room, edited("\"indices\":3", "\"mode\":5")));
   s = ex_scene_load(path, error); /* a strip without indices: 0 1 2, 2 1 3, 2 3 4, 4 3 5 */
   CHECK_MSG(s && s->triangles == T && !memcmp(s->triangle, faces, sizeof faces), "%s", error);
   ex_scene_free(s);
   save(path, room, make_glb(room, edited("\"inverseBindMatrices\":4", "\"name\":\"x\"")));
   s = ex_scene_load(path, error); /* absent: the identity */
   CHECK_MSG(s && s->inverse_bind[0] == 1 && s->inverse_bind[7] == 0, "%s", error);
   ex_scene_free(s);
   save(path, room, make_glb(room, edited("{\"attributes\":{\"POSITION\":0,", "{\"attributes\":{\"POSITION\":0,\"JOINTS_1\":1,\"WEIGHTS_1\":2,")));
   s = ex_scene_load(path, error); /* eight influences */
   CHECK_MSG(s && s->influences == 8 && s->skin_weights[8 * 2 + 4] == s->skin_weights[8 * 2], "%s", error);
   ex_scene_free(s);
   save(path, room, make_glb(room, edited("\"scenes\":[{\"nodes\":[0,3]}],\"nodes\":[", "\"scenes\":[{\"nodes\":[0,3,4]}],\"nodes\":[")));
   { /* the same mesh under the same skin once more, and a mesh without a skin */
      char two[12288];
      const char *at = strstr(gltf, "],\"meshes\"");
      snprintf(two, sizeof two, "%.*s,{\"name\":\"hat\",\"mesh\":0}%s", (int)(at - gltf), gltf, at);
      save(path, room, make_glb(room, two));
      s = ex_scene_load(path, error);
      CHECK_MSG(s && s->vertices == V && s->meshes_left_out == 1, "%s", error);
      ex_scene_free(s);
   }
   remove(path);
}
TEST(gltf_that_is_wrong)
{
   static const char *const edit[][3] = { /* passage, replacement, what the line must say */
      {"\"skin\":0,", "", "no mesh that uses it"},
      {"\"mesh\":0,\"skin\":0,", "", "no mesh that uses it"},
      {"\"mesh\":0,\"skin\":0", "\"mesh\":7,\"skin\":0", ""},
      {"\"mesh\":0,\"skin\":0", "\"mesh\":0,\"skin\":7", ""},
      {"\"joints\":[2,1]", "\"joints\":[2,99]", "99"},
      {"\"joints\":[2,1]", "\"joints\":[2,2]", "twice"},
      {"\"joints\":[2,1]", "\"joints\":[2]", "joint 1 of 1"},
      {"\"children\":[2]", "\"children\":[0]", ""},
      {"\"children\":[2]", "\"children\":[77]", ""},
      {"\"children\":[2]", "\"children\":[1]", ""},
      {"\"inverseBindMatrices\":4", "\"inverseBindMatrices\":44", "44"},
      {"\"inverseBindMatrices\":4", "\"inverseBindMatrices\":0", "type"},
      {"\"POSITION\":0", "\"POSITION\":99", "99"},
      {"\"POSITION\":0", "\"POSITION\":1", "type"},
      {"\"JOINTS_0\":1,", "", "JOINTS_0"},
      {"\"indices\":3", "\"indices\":99", ""},
      {"\"count\":6,\"type\":\"VEC3\",\"min\":[0,1,0]", "\"count\":600000000,\"type\":\"VEC3\",\"min\":[0,1,0]", "do not fit"},
      {"\"count\":6,\"type\":\"VEC3\",\"min\":[0,1,0]", "\"count\":3,\"type\":\"VEC3\",\"min\":[0,1,0]", ""},
      {"\"byteOffset\":0,\"byteLength\":72", "\"byteOffset\":400,\"byteLength\":72", ""},
      {"\"byteOffset\":0,\"byteLength\":72", "\"byteOffset\":0,\"byteLength\":71", "do not fit"},
      {"{\"buffer\":0,\"byteOffset\":120", "{\"buffer\":5,\"byteOffset\":120", ""},
      {"\"asset\":{\"version\":\"2.0\"}", "\"asset\":{\"version\":\"2.0\"},\"extensionsRequired\":[\"KHR_draco_mesh_compression\"],\"extensionsUsed\":[\"KHR_draco_mesh_compression\"]", "draco"},
      {"\"meshes\":[", "\"mxshes\":[", ""},
      {"\"attributes\":{\"POSITION\":0,", "\"mode\":1,\"attributes\":{\"POSITION\":0,", "without triangles"}
   };
   const char *path = file("o.glb");
   size_t i, n = 0;
   for (i = 0; i < sizeof edit / sizeof *edit; i++) {
      ex_scene *s;
      save(path, room, make_glb(room, edited(edit[i][0], edit[i][1])));
      s = ex_scene_load(path, error);
      n += (size_t)CHECK_MSG(refused(s, path) && strstr(error, edit[i][2]), "%s -> %s: %s", edit[i][0], edit[i][1], s ? "accepted" : error);
      ex_scene_free(s);
   }
   { /* neither a skin nor a mention of one */
      char bare[12288];
      const char *json = edited("\"skin\":0,", ""), *at = strstr(json, "\"skins\":"), *end = strstr(json, "\"animations\"");
      ex_scene *s;
      snprintf(bare, sizeof bare, "%.*s%s", (int)(at - json), json, end);
      save(path, room, make_glb(room, bare));
      s = ex_scene_load(path, error);
      CHECK_MSG(refused(s, path) && strstr(error, "not skinned"), "%s", error);
      ex_scene_free(s);
   }
   { /* motions */
      static const char *const clip[][2] = {
         {"\"sampler\":0,", "\"sampler\":9,"}, {"\"node\":2,\"path\":\"rotation\"", "\"node\":99,\"path\":\"rotation\""},
         {"{\"input\":5,", "{\"input\":55,"}, {"{\"input\":5,", "{\"input\":1,"}, {"\"output\":6}", "\"output\":0}"}, {"\"output\":6}", "\"output\":2}"}
      };
      parts p = good_parts();
      const char *body = file("p.safetensors");
      ex_scene *s = through_file(&p, body);
      for (i = 0; i < sizeof clip / sizeof *clip; i++) {
         ex_motion *m;
         save(path, room, make_glb(room, edited(clip[i][0], clip[i][1])));
         m = ex_motion_load(path, NULL, s, error);
         n += (size_t)CHECK_MSG(refused(m, path), "%s -> %s: %s", clip[i][0], clip[i][1], m ? "accepted" : error);
         ex_motion_free(m);
      }
      ex_scene_free(s);
      remove(body);
   }
   AT_LEAST(n, 25, "refusals");
   remove(path);
}
TEST(gltf_cut_or_changed_anywhere)
{
   const char *path = file("q.glb");
   size_t size = make_glb(room, gltf), k, lived = 0, refusals = 0;
   uint64_t seed = 1;
   ex_scene *s;
   ex_motion *m;
   for (k = 0; k < size; k += k < 64 ? 1 : 37) {
      save(path, room, k);
      s = ex_scene_load(path, error);
      refusals += (size_t)CHECK_MSG(refused(s, path), "%lu bytes accepted", (unsigned long)k);
      ex_scene_free(s);
   }
   AT_LEAST(refusals, 100, "prefixes");
   for (k = 0; k < 1500; k++) { /* a changed byte is refused in one line or gives a scene that can be posed */
      size_t at = 20 + test_random(&seed) % (size - 20);
      unsigned char old = room[at];
      float palette[12 * 8];
      room[at] = (unsigned char)(old ^ (1u << test_random(&seed) % 7));
      save(path, room, size);
      s = ex_scene_load(path, error);
      if (!s) CHECK_MSG(refused(s, path), "byte %lu: %s", (unsigned long)at, error);
      else {
         lived++;
         m = ex_motion_load(path, NULL, s, error);
         if (m && s->joints <= 8) ex_pose(s, m, m->frames - 1, palette);
         CHECK_MSG(m || refused(m, path), "byte %lu: %s", (unsigned long)at, error);
         ex_motion_free(m);
      }
      ex_scene_free(s);
      room[at] = old;
   }
   AT_LEAST(lived, 100, "changed files that still load");
   remove(path);
}
#endif

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   snprintf(folder, sizeof folder, "%s/scene-%lx-%lx", argc > 2 ? argv[2] : "build", (unsigned long)time(NULL), (unsigned long)((uintptr_t)&argc >> 4 & 0xffffff));
   RUN(tensors_come_back);
   RUN(writer_leaves_no_half_file);
   RUN(hostile_safetensors);
   RUN(character_safetensors);
   RUN(joints_in_any_order);
   RUN(characters_that_are_wrong);
   RUN(motion_by_palettes);
   RUN(baked_animation);
   RUN(obj_meshes);
   RUN(turns_from_axis_angle);
#ifdef EX_TINYGLTF
   RUN(gltf_character_and_motion);
   RUN(gltf_turns);
   RUN(gltf_meshes);
   RUN(gltf_variants);
   RUN(gltf_that_is_wrong);
   RUN(gltf_cut_or_changed_anywhere);
#else
   RUN(gltf_without_a_reader);
#endif
   return TEST_END();
}
