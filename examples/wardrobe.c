/*  wardrobe.c - a parametric body puts on garments: shape, pose and looseness from the command line
    shows     dn_shape and dn_dressed of deformnet.h: load a body and garments, bind them once, change shape and looseness
              by one call, pose, keep cloth outside skin; with trained garment networks (--refine) or with none
    not here  reading motions (common/scene.h), pictures (common/picture.h), GLB (common/glb.h), threads (common/pool.h)
    build     make wardrobe
    run       ./wardrobe --body body.safetensors --garment skirt.safetensors --garment tee.safetensors:0.01 --picture all.png
              ./wardrobe --body body.safetensors --garment dress.safetensors --shape 1,-2 --pose squat --out squat.obj
              ./wardrobe --body body.safetensors --garment tee.safetensors --motion walk.glb --out walk.glb
    flow      body, garments --dn_dressed_create--> dressed --shape: dn_dressed_change--+
              pose: joints' turns (S,9) ------------------------------dn_dressed_deform-+--> meshes (V,3) --> OBJ, GLB, PNG */
#define _POSIX_C_SOURCE 200809L
#define DEFORMNET_IMPLEMENTATION
#include "../deformnet.h"
#include "common/glb.h"
#include "common/picture.h"
#include "common/pool.h"
#include "common/scene.h"
#include "common/tool.h"
#include <errno.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ===================================================================================== >>small things */
static const char usage[] =
   "usage: wardrobe --body B.safetensors [--garment G.safetensors[:looseness[:margin]]].. [--shape b0,b1,..].. [--pose P]..\n"
   "                [--motion A.glb] [--animation NAME] [--frames a:b[:step]]\n"
   "                [--coarse M.safetensors] [--refine M.safetensors] [--alpha a0,a1,..] [--body-model M.safetensors]\n"
   "                [--looseness m] [--margin m] [--threads n] [--out O.obj|O.glb] [--picture P.png]\n"
   "  --garment     innermost first; looseness and margin in metres (0 and 0.004; margin 0: no collision pass)\n"
   "  --shape       coefficients, the others are 0; several --shape are rows of the picture, --out takes the first\n"
   "  --pose        rest, tpose, arms-up, squat, walk; or turns in degrees about the rest pose's axes,\n"
   "                \"LeftArm=0,0,45;Spine=20,0,0\"; or 3 S numbers, axis-angle in radians. Several are columns of the picture\n"
   "  --motion      poses from a clip, by joint names\n"
   "  --coarse, --refine, --alpha   garfit_coarse, garfitnet or clothnet models for every garment, and their fit factors;\n"
   "                without them garments follow the body by association\n"
   "  --body-model  a model that refines the body's own skinning\n"
   "  --out         .obj: the first shape and pose; .glb: the first shape in every pose, as an animation\n";

static const char *file_name(const char *path)
{
   const char *slash = strrchr(path, '/');
   return slash ? slash + 1 : path;
}
/* comma-separated finite numbers into out; how many, or -1 */
static int read_floats(const char *s, float *out, int room)
{
   int n = 0;
   for (;; s++) {
      char *end;
      float x = strtof(s, &end);
      if (end == s || !isfinite(x) || n == room) return -1;
      out[n++] = x;
      if (!*end) return n;
      if (*end != ',') return -1;
      s = end;
   }
}

/* ===================================================================================== >>options */
enum { MAX_GARMENTS = 8, MAX_SHAPES = 16, MAX_POSES = 32, MAX_BETA = 300, MAX_ALPHA = 16 };
typedef struct garment_option { char *path; float looseness, margin; int has_looseness, has_margin; } garment_option;
typedef struct options {
   const char *body, *motion, *animation, *coarse, *refine, *body_model, *out, *picture;
   garment_option garment[MAX_GARMENTS];
   float beta[MAX_SHAPES][MAX_BETA], alpha[MAX_ALPHA], looseness, margin;
   int betas[MAX_SHAPES], garments, shapes, poses, alphas;
   const char *pose[MAX_POSES];
   long first, end, step;
   unsigned threads;
} options;

static int read_garment(options *o, const char *value)
{
   garment_option *g = &o->garment[o->garments];
   char *colon, *rest;
   if (o->garments == MAX_GARMENTS) return ex_say("--garment: at most %d", MAX_GARMENTS);
   if (!(g->path = (char *)ex_take(strlen(value) + 1, 1))) return ex_say("out of memory");
   strcpy(g->path, value);
   o->garments++;
   colon = strstr(g->path, ".safetensors:");
   if (!colon) return 0;
   colon += strlen(".safetensors");
   *colon = 0;
   g->looseness = strtof(colon + 1, &rest);
   g->has_looseness = rest != colon + 1;
   if (*rest == ':' && rest[1]) {
      char *number = rest + 1;
      g->margin = strtof(number, &rest);
      g->has_margin = rest != number;
      if (!g->has_margin) return ex_say("--garment %s: expected FILE:looseness:margin", value);
   }
   return *rest || !g->has_looseness ? ex_say("--garment %s: expected FILE:looseness:margin", value) : 0;
}
static int read_options(options *o, int argc, char **argv)
{
   int i;
   memset(o, 0, sizeof *o);
   o->margin = 0.004f;
   o->end = LONG_MAX;
   o->step = 1;
   for (i = 1; i < argc; i++) {
      const char *key = argv[i], *value = i + 1 < argc ? argv[i + 1] : NULL;
      const char **text = strcmp(key, "--body") == 0         ? &o->body
                        : strcmp(key, "--motion") == 0       ? &o->motion
                        : strcmp(key, "--animation") == 0    ? &o->animation
                        : strcmp(key, "--coarse") == 0       ? &o->coarse
                        : strcmp(key, "--refine") == 0       ? &o->refine
                        : strcmp(key, "--body-model") == 0   ? &o->body_model
                        : strcmp(key, "--out") == 0          ? &o->out
                        : strcmp(key, "--picture") == 0      ? &o->picture
                                                             : NULL;
      if (strcmp(key, "--help") == 0 || strcmp(key, "-h") == 0) {
         fputs(usage, stdout);
         exit(0);
      }
      if (!value) return ex_say(text ? "%s needs a value" : "unknown argument \"%s\" (--help lists them)", key);
      i++;
      if (text) *text = value;
      else if (strcmp(key, "--garment") == 0) {
         if (read_garment(o, value)) return 1;
      } else if (strcmp(key, "--shape") == 0) {
         if (o->shapes == MAX_SHAPES || (o->betas[o->shapes] = read_floats(value, o->beta[o->shapes], MAX_BETA)) < 0)
            return ex_say("--shape %s: expected numbers, comma separated; at most %d shapes", value, MAX_SHAPES);
         o->shapes++;
      } else if (strcmp(key, "--pose") == 0) {
         if (o->poses == MAX_POSES) return ex_say("--pose: at most %d", MAX_POSES);
         o->pose[o->poses++] = value;
      } else if (strcmp(key, "--alpha") == 0) {
         if ((o->alphas = read_floats(value, o->alpha, MAX_ALPHA)) < 0) return ex_say("--alpha %s: expected numbers, comma separated", value);
      } else if (strcmp(key, "--looseness") == 0) {
         if (read_floats(value, &o->looseness, 1) != 1) return ex_say("--looseness %s: expected metres", value);
      } else if (strcmp(key, "--margin") == 0) {
         if (read_floats(value, &o->margin, 1) != 1 || o->margin < 0) return ex_say("--margin %s: expected metres, at least 0", value);
      } else if (strcmp(key, "--threads") == 0) {
         char *rest;
         long n = strtol(value, &rest, 10);
         if (*rest || n < 1 || n > 256) return ex_say("--threads %s: expected 1 to 256", value);
         o->threads = (unsigned)n;
      } else if (strcmp(key, "--frames") == 0) {
         char *at = (char *)(uintptr_t)value;
         if (*at != ':') o->first = strtol(at, &at, 10);
         if (*at++ != ':') return ex_say("--frames %s: expected a:b or a:b:step", value);
         if (*at && *at != ':') o->end = strtol(at, &at, 10);
         if (*at == ':') o->step = strtol(at + 1, &at, 10);
         if (*at || o->first < 0 || o->end <= o->first || o->step < 1) return ex_say("--frames %s: expected a:b or a:b:step, a < b", value);
      } else return ex_say("unknown argument \"%s\" (--help lists them)", key);
   }
   if (!o->body) return ex_say("--body is needed (--help explains)");
   if (o->motion && o->poses) return ex_say("--motion or --pose, not both");
   if (o->out && !ex_ends_with(o->out, ".obj") && !ex_ends_with(o->out, ".glb")) return ex_say("--out %s: expected a name ending in .obj or .glb", o->out);
   if (!o->shapes) o->shapes = 1;
   if (!o->poses && !o->motion) o->pose[o->poses++] = "rest";
   if (!o->threads) o->threads = ex_processors();
   return 0;
}

/* ===================================================================================== >>poses */
typedef struct stance { /* one pose of the body at hand */
   char title[64];
   float *rotations;   /* (S,9) */
   float *theta;       /* (S,3) the same as axis-angle, which garment models read */
   float travel[3];    /* of the root */
   int grounded;       /* the lowest vertex goes to where it is at rest */
   float time;
} stance;

static void multiply3(const float a[9], const float b[9], float out[9])
{
   float r[9];
   int i, k;
   for (i = 0; i < 3; i++)
      for (k = 0; k < 3; k++) r[3 * i + k] = a[3 * i] * b[k] + a[3 * i + 1] * b[3 + k] + a[3 * i + 2] * b[6 + k];
   memcpy(out, r, sizeof r);
}
static void quaternion_matrix(const float q[4], float m[9]) /* x y z w, of any length but 0 */
{
   float l = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3], s = l > 0 ? 2 / l : 0, x = q[0], y = q[1], z = q[2], w = q[3];
   m[0] = 1 - s * (y * y + z * z), m[1] = s * (x * y - z * w), m[2] = s * (x * z + y * w);
   m[3] = s * (x * y + z * w), m[4] = 1 - s * (x * x + z * z), m[5] = s * (y * z - x * w);
   m[6] = s * (x * z - y * w), m[7] = s * (y * z + x * w), m[8] = 1 - s * (x * x + y * y);
}
static void axis_angle_of(const float m[9], float a[3])
{
   double x = (double)m[7] - (double)m[5], y = (double)m[2] - (double)m[6], z = (double)m[3] - (double)m[1];
   double twice_sine = sqrt(x * x + y * y + z * z), twice_cosine = (double)m[0] + (double)m[4] + (double)m[8] - 1;
   double angle = atan2(twice_sine, twice_cosine), by = twice_sine > 1e-6 ? angle / twice_sine : 0.5;
   if (twice_sine < 1e-6 && twice_cosine < 0) { /* half a turn: the axis is the largest column of (R + I) / 2 */
      int k = m[0] >= m[4] && m[0] >= m[8] ? 0 : m[4] >= m[8] ? 1 : 2, r;
      double length = sqrt(fmax(((double)m[4 * k] + 1) / 2, 0));
      for (r = 0; r < 3; r++) a[r] = (float)(3.141592653589793 * ((double)m[3 * r + k] + (r == k)) / 2 / fmax(length, 1e-9));
      return;
   }
   a[0] = (float)(x * by), a[1] = (float)(y * by), a[2] = (float)(z * by);
}
/* names of a joint in the skeletons at hand: Mixamo's and SMPL's */
static const char *const aliases[][2] = {
   {"Hips", "pelvis"}, {"Spine", "spine1"}, {"LeftUpLeg", "left_hip"}, {"RightUpLeg", "right_hip"}, {"LeftLeg", "left_knee"},
   {"RightLeg", "right_knee"}, {"LeftFoot", "left_ankle"}, {"RightFoot", "right_ankle"}, {"LeftArm", "left_shoulder"},
   {"RightArm", "right_shoulder"}, {"LeftForeArm", "left_elbow"}, {"RightForeArm", "right_elbow"}, {"LeftShoulder", "left_collar"},
   {"RightShoulder", "right_collar"}};
static int find_joint(const dn_shape_view *b, const char *name, size_t length)
{
   size_t s, k;
   const char *other = "";
   for (k = 0; k < sizeof aliases / sizeof *aliases; k++)
      if (strlen(aliases[k][0]) == length && strncmp(aliases[k][0], name, length) == 0) other = aliases[k][1];
   for (s = 0; b->joint_names && s < b->joints; s++) {
      const char *core = ex_short_name(b->joint_names[s]);
      if ((strlen(core) == length && strncmp(core, name, length) == 0) || (*other && strcmp(core, other) == 0)) return (int)s;
   }
   return -1;
}
/* turns a joint by degrees about the axes of the rest pose, after what it was turned by */
static void turn(const dn_shape_view *b, stance *p, const char *name, float x, float y, float z)
{
   float a[3], r[9];
   int s = find_joint(b, name, strlen(name));
   if (s < 0) return;
   a[0] = x * 0.0174532925f, a[1] = y * 0.0174532925f, a[2] = z * 0.0174532925f;
   dn_rodrigues(a, r);
   multiply3(r, p->rotations + 9 * s, p->rotations + 9 * s);
}
/* brings an arm to an elevation over the horizontal: bodies rest with their arms at different heights */
static void raise_arm(const dn_shape_view *b, stance *p, int left, float elevation)
{
   const char *arm = left ? "LeftArm" : "RightArm", *elbow = left ? "LeftForeArm" : "RightForeArm";
   int from = find_joint(b, arm, strlen(arm)), to = find_joint(b, elbow, strlen(elbow));
   float rest, by;
   if (from < 0 || to < 0) return;
   rest = atan2f(b->joint_rest[3 * to + 1] - b->joint_rest[3 * from + 1], fabsf(b->joint_rest[3 * to] - b->joint_rest[3 * from])) * 57.2957795f;
   by = elevation - rest;
   if (elevation > 30) { /* the shoulder blade takes its part */
      turn(b, p, left ? "LeftShoulder" : "RightShoulder", 0, 0, (left ? 0.25f : -0.25f) * by);
      by *= 0.75f;
   }
   turn(b, p, arm, 0, 0, left ? by : -by);
}
static int named_pose(const dn_shape_view *b, stance *p, const char *name)
{
   p->grounded = 1;
   if (strcmp(name, "rest") == 0) return 0;
   if (strcmp(name, "tpose") == 0) {
      raise_arm(b, p, 1, 0), raise_arm(b, p, 0, 0);
      return 0;
   }
   if (strcmp(name, "arms-up") == 0) {
      raise_arm(b, p, 1, 72), raise_arm(b, p, 0, 72);
      return 0;
   }
   if (strcmp(name, "squat") == 0) {
      turn(b, p, "Spine", 30, 0, 0);
      turn(b, p, "LeftUpLeg", -85, 0, 0), turn(b, p, "LeftUpLeg", 0, 14, 0), turn(b, p, "RightUpLeg", -85, 0, 0), turn(b, p, "RightUpLeg", 0, -14, 0);
      turn(b, p, "LeftLeg", 100, 0, 0), turn(b, p, "RightLeg", 100, 0, 0), turn(b, p, "LeftFoot", -15, 0, 0), turn(b, p, "RightFoot", -15, 0, 0);
      raise_arm(b, p, 1, -25), raise_arm(b, p, 0, -25);
      turn(b, p, "LeftArm", 0, -72, 0), turn(b, p, "RightArm", 0, 72, 0);
      return 0;
   }
   if (strcmp(name, "walk") == 0) {
      turn(b, p, "LeftUpLeg", -30, 0, 0), turn(b, p, "LeftLeg", 12, 0, 0), turn(b, p, "RightUpLeg", 22, 0, 0), turn(b, p, "RightLeg", 28, 0, 0);
      turn(b, p, "RightFoot", 12, 0, 0), turn(b, p, "LeftFoot", 8, 0, 0), turn(b, p, "Spine", 3, -6, 0);
      raise_arm(b, p, 1, -72), raise_arm(b, p, 0, -72);
      turn(b, p, "LeftArm", 24, 0, 0), turn(b, p, "RightArm", -24, 0, 0);
      return 0;
   }
   return 1;
}
static int make_stance(const dn_shape_view *b, stance *p, const char *text)
{
   size_t s;
   const char *at;
   p->rotations = (float *)ex_take(b->joints, 9 * sizeof(float));
   p->theta = (float *)ex_take(b->joints, 3 * sizeof(float));
   if (!p->rotations || !p->theta) return ex_say("out of memory");
   snprintf(p->title, sizeof p->title, "%s", text);
   for (s = 0; s < b->joints; s++) p->rotations[9 * s] = p->rotations[9 * s + 4] = p->rotations[9 * s + 8] = 1;
   if (strchr(text, '=')) {
      for (at = text; *at; ) {
         const char *equal = strchr(at, '='), *end = strchr(at, ';');
         char number[64], name[64];
         float a[3];
         if (!end) end = at + strlen(at);
         if (!equal || equal > end || (size_t)(end - equal) > sizeof number || (size_t)(equal - at) >= sizeof name) return ex_say("--pose %s: expected JOINT=x,y,z;..", text);
         snprintf(number, sizeof number, "%.*s", (int)(end - equal - 1), equal + 1);
         snprintf(name, sizeof name, "%.*s", (int)(equal - at), at);
         if (read_floats(number, a, 3) != 3) return ex_say("--pose %s: expected three angles in degrees for %s", text, name);
         if (find_joint(b, name, strlen(name)) < 0) return ex_say("--pose %s: the body has no joint \"%s\"", text, name);
         turn(b, p, name, a[0], a[1], a[2]);
         at = *end ? end + 1 : end;
      }
      p->grounded = 1;
   } else if (named_pose(b, p, text) != 0) {
      float *a = (float *)ex_take(3 * b->joints, sizeof(float));
      int n = a ? read_floats(text, a, (int)(3 * b->joints)) : -1;
      if (n != (int)(3 * b->joints)) {
         free(a);
         return ex_say("--pose %.80s: not a pose by name, nor %zu numbers, nor JOINT=x,y,z (--help)", text, 3 * b->joints);
      }
      for (s = 0; s < b->joints; s++) dn_rodrigues(a + 3 * s, p->rotations + 9 * s);
      free(a);
      snprintf(p->title, sizeof p->title, "given");
      p->grounded = 1;
   }
   for (s = 0; s < b->joints; s++) axis_angle_of(p->rotations + 9 * s, p->theta + 3 * s);
   return 0;
}
/* every step-th frame of a clip, through common/scene.h: the body as a character of that library of examples */
static int motion_stances(const options *o, const dn_shape *body, const dn_shape_view *b, stance **out, size_t *count)
{
   char error[EX_ERROR];
   ex_scene scene;
   ex_motion *m;
   size_t s, f, n = 0;
   int bad;
   (void)body;
   if (!b->joint_names) return ex_say("%s: the body names no joints, so no motion can be matched", o->body);
   memset(&scene, 0, sizeof scene);
   scene.path = (char *)(uintptr_t)o->body;
   scene.vertices = b->vertices, scene.triangles = b->triangles, scene.joints = b->joints, scene.influences = b->influences;
   scene.positions = (float *)(uintptr_t)b->rest, scene.triangle = (uint32_t *)(uintptr_t)b->triangle;
   scene.skin_joints = (uint32_t *)(uintptr_t)b->skin_joint, scene.skin_weights = (float *)(uintptr_t)b->skin_weight;
   scene.names = (char **)(uintptr_t)b->joint_names, scene.parents = (int32_t *)(uintptr_t)b->parents;
   scene.joint_rest = (float *)(uintptr_t)b->joint_rest;
   scene.rest = (float *)ex_take(b->joints, 10 * sizeof(float));
   scene.above = (float *)ex_take(b->joints, 12 * sizeof(float));
   scene.inverse_bind = (float *)ex_take(b->joints, 12 * sizeof(float));
   bad = !scene.rest || !scene.above || !scene.inverse_bind;
   for (s = 0; !bad && s < b->joints; s++) {
      int k, parent = (int)b->parents[s];
      for (k = 0; k < 3; k++) {
         scene.rest[10 * s + (size_t)k] = b->joint_rest[3 * s + (size_t)k] - (parent < 0 ? 0 : b->joint_rest[3 * parent + k]);
         scene.rest[10 * s + 7 + (size_t)k] = 1;
         scene.above[12 * s + 5 * (size_t)k] = scene.inverse_bind[12 * s + 5 * (size_t)k] = 1;
         scene.inverse_bind[12 * s + 4 * (size_t)k + 3] = -b->joint_rest[3 * s + (size_t)k];
      }
      scene.rest[10 * s + 6] = 1;
   }
   m = bad ? NULL : ex_motion_load(o->motion, o->animation, &scene, error);
   if (!m || !m->local) bad = m ? ex_say("%s: the motion has palettes, expected joint rotations", o->motion) : bad ? ex_say("out of memory") : ex_say("%s", error);
   if (!bad) {
      for (f = (size_t)o->first; f < m->frames && f < (size_t)o->end; f += (size_t)o->step) n++;
      if (!n) bad = ex_say("--frames: no frame in that range; there are %zu", m->frames);
      else if (!(*out = (stance *)ex_take(n, sizeof **out))) bad = ex_say("out of memory");
   }
   for (f = (size_t)o->first; !bad && *count < n; f += (size_t)o->step) {
      stance *p = *out + (*count)++;
      int k;
      bad = make_stance(b, p, "rest");
      if (bad) break;
      snprintf(p->title, sizeof p->title, "frame %zu", f);
      p->grounded = 0;
      p->time = m->times[f] - m->times[(size_t)o->first];
      for (s = 0; s < b->joints; s++) {
         quaternion_matrix(m->local + 10 * (f * b->joints + s) + 3, p->rotations + 9 * s);
         axis_angle_of(p->rotations + 9 * s, p->theta + 3 * s);
      }
      for (k = 0; k < 3; k++) p->travel[k] = m->local[10 * f * b->joints + (size_t)k] - scene.rest[k];
   }
   ex_motion_free(m);
   free(scene.rest), free(scene.above), free(scene.inverse_bind);
   return bad;
}

/* ===================================================================================== >>the job */
enum { MESHES = MAX_GARMENTS + 1 };
static const uint32_t skin_colour = 0xb98d74, cloth_colours[MAX_GARMENTS] = {0x4c6a86, 0xa65b4b, 0x6d7f52, 0x8a6a9c, 0xc29b4a, 0x4f8b84, 0x7a5a48, 0x5a5f66};

typedef struct job {
   options o;
   dn_shape *shape[MESHES];      /* the body, then the garments */
   dn_shape_view view[MESHES];
   dn_model *coarse, *refine, *body_model;
   dn_dressed *dressed;
   ex_pool *pool;
   dn_parallel parallel;
   stance *stances;
   size_t stance_count, meshes;
   void *block, *scratch, *change_block, *change;
   size_t scratch_bytes, change_bytes;
   float *positions[MAX_SHAPES * MAX_POSES][MESHES], *normals[MAX_SHAPES * MAX_POSES][MESHES]; /* what the picture shows */
   float *all, *all_normals, *times; /* (F,V,3) of all meshes one after another, for GLB */
   size_t all_vertices, all_triangles;
   uint32_t *all_triangle;
} job;

static int load_model(const char *path, dn_model **model)
{
   dn_error e;
   if (!path) return 0;
   *model = dn_model_load_file(path, NULL, NULL, &e);
   return *model ? 0 : ex_say_error(path, &e);
}
static int open_all(job *j)
{
   dn_dressed_garment garment[MAX_GARMENTS];
   dn_dressed_desc d;
   dn_error e;
   size_t i, k, n = 0;
   double start;
   memset(garment, 0, sizeof garment);
   memset(&d, 0, sizeof d);
   j->meshes = 1 + (size_t)j->o.garments;
   for (i = 0; i < j->meshes; i++) {
      const char *path = i ? j->o.garment[i - 1].path : j->o.body;
      if (!(j->shape[i] = dn_shape_load_file(path, NULL, &e))) return ex_say_error(path, &e);
      dn_shape_describe(j->shape[i], &j->view[i]);
      j->all_vertices += j->view[i].vertices, j->all_triangles += j->view[i].triangles;
   }
   if (load_model(j->o.coarse, &j->coarse) || load_model(j->o.refine, &j->refine) || load_model(j->o.body_model, &j->body_model)) return 1;
   for (k = 0; k < (size_t)j->o.shapes; k++)
      if (j->o.betas[k] > (int)j->view[0].coefficients) return ex_say("--shape: %d coefficients, the body has %zu", j->o.betas[k], j->view[0].coefficients);
   for (i = 0; i < (size_t)j->o.garments; i++) {
      const garment_option *g = &j->o.garment[i];
      garment[i].shape = j->shape[i + 1];
      garment[i].coarse = j->coarse, garment[i].refine = j->refine;
      garment[i].alpha = j->o.alpha, garment[i].alphas = (size_t)j->o.alphas;
      garment[i].looseness = g->has_looseness ? g->looseness : j->o.looseness;
      garment[i].margin = g->has_margin ? g->margin : j->o.margin;
      garment[i].layer = (unsigned)i;
      if (garment[i].looseness != 0 && !j->view[i + 1].has_looseness) printf("%s has no looseness_dirs: its looseness does nothing\n", g->path);
   }
   j->pool = ex_pool_create(j->o.threads);
   j->parallel = ex_pool_parallel(j->pool);
   d.body = j->shape[0], d.refine = j->body_model;
   d.beta = j->o.beta[0], d.betas = (size_t)j->o.betas[0];
   d.garment = garment, d.garments = (size_t)j->o.garments;
   d.parallel = &j->parallel;
   start = ex_now_ms();
   if (!(j->dressed = dn_dressed_create(&d, NULL, &e))) return ex_say_error(j->o.body, &e);
   printf("body: %zu vertices, %zu triangles, %zu joints, %zu coefficients; dressed in %.1f ms\n", j->view[0].vertices, j->view[0].triangles,
          j->view[0].joints, j->view[0].coefficients, ex_now_ms() - start);
   j->scratch_bytes = dn_dressed_scratch_size(j->dressed, j->parallel.workers);
   j->change_bytes = dn_dressed_change_size(j->dressed, j->parallel.workers);
   j->block = ex_take(j->scratch_bytes + 63, 1), j->change_block = ex_take(j->change_bytes + 63, 1);
   if (!j->block || !j->change_block) return ex_say("out of memory");
   j->scratch = (void *)(((uintptr_t)j->block + 63) & ~(uintptr_t)63);
   j->change = (void *)(((uintptr_t)j->change_block + 63) & ~(uintptr_t)63);
   if (j->o.motion) {
      if (motion_stances(&j->o, j->shape[0], &j->view[0], &j->stances, &j->stance_count)) return 1;
   } else {
      if (!(j->stances = (stance *)ex_take((size_t)j->o.poses, sizeof *j->stances))) return ex_say("out of memory");
      for (; j->stance_count < (size_t)j->o.poses; j->stance_count++) {
         if (make_stance(&j->view[0], &j->stances[j->stance_count], j->o.pose[j->stance_count])) {
            j->stance_count++;
            return 1;
         }
         j->stances[j->stance_count].time = (float)j->stance_count;
      }
   }
   if (j->o.out) {
      uint32_t from = 0;
      if (j->all_vertices > UINT32_MAX / 2) return ex_say("too many vertices");
      j->all = (float *)ex_take(j->stance_count * j->all_vertices, 12), j->all_normals = (float *)ex_take(j->stance_count * j->all_vertices, 12);
      j->all_triangle = (uint32_t *)ex_take(j->all_triangles, 12), j->times = (float *)ex_take(j->stance_count, sizeof(float));
      if (!j->all || !j->all_normals || !j->all_triangle || !j->times) return ex_say("out of memory");
      for (i = 0; i < j->meshes; from += (uint32_t)j->view[i++].vertices)
         for (k = 0; k < 3 * j->view[i].triangles; k++) j->all_triangle[n++] = j->view[i].triangle[k] + from;
   }
   return 0;
}
/* one shape in one pose; keeps what the outputs need */
static int run_frame(job *j, size_t s, size_t f, double *ms, dn_collision *worst)
{
   stance *p = &j->stances[f];
   dn_dressed_mesh mesh[MESHES];
   dn_dressed_pose pose;
   dn_error e;
   dn_result r;
   size_t i, v, from = 0;
   int shown = j->o.picture && f < MAX_POSES, pass;
   float **positions = shown ? j->positions[s * MAX_POSES + f] : NULL;
   dn_dressed_view d;
   dn_dressed_describe(j->dressed, &d);
   memset(mesh, 0, sizeof mesh);
   memset(&pose, 0, sizeof pose);
   pose.rotations = p->rotations, pose.theta = p->theta, pose.strength = 1;
   memcpy(pose.translation, p->travel, sizeof pose.translation);
   for (i = 0; i < j->meshes; i++) {
      size_t bytes = j->view[i].vertices;
      if (shown) {
         positions[i] = (float *)ex_take(bytes, 12), j->normals[s * MAX_POSES + f][i] = (float *)ex_take(bytes, 12);
         if (!positions[i] || !j->normals[s * MAX_POSES + f][i]) return ex_say("out of memory");
         mesh[i].positions = positions[i], mesh[i].normals = j->normals[s * MAX_POSES + f][i];
      } else if (j->o.out && s == 0) {
         mesh[i].positions = j->all + 3 * (f * j->all_vertices + from), mesh[i].normals = j->all_normals + 3 * (f * j->all_vertices + from);
      }
      from += bytes;
   }
   for (pass = 0; pass <= p->grounded; pass++) { /* once to see how low it stands, once more where it should */
      double start = ex_now_ms();
      r = dn_dressed_deform(j->dressed, &pose, &mesh[0], mesh + 1, NULL, j->scratch, j->scratch_bytes, &j->parallel, &e);
      *ms = ex_now_ms() - start;
      if (r != DN_OK && r != DN_NOT_FINITE) return ex_say_error(p->title, &e);
      if (r == DN_NOT_FINITE) printf("  %s: %s\n", p->title, e.info);
      if (pass == 0 && p->grounded) {
         float low = 1e30f;
         for (v = 0; v < d.vertices; v++) low = fminf(low, d.rest[3 * v + 1]);
         pose.translation[1] += low - mesh[0].bounds_min[1];
      }
   }
   for (i = 1; i < j->meshes; i++) {
      const dn_collision *c = &mesh[i].collision;
      if (c->deepest >= worst[i].deepest) worst[i].deepest = c->deepest;
      if (c->left > worst[i].left) worst[i].left = c->left;
      worst[i].moved += c->moved, worst[i].inside += c->inside, worst[i].squeezed += c->squeezed;
   }
   if (shown && j->o.out && s == 0)
      for (from = i = 0; i < j->meshes; from += j->view[i++].vertices) {
         memcpy(j->all + 3 * (f * j->all_vertices + from), positions[i], 12 * j->view[i].vertices);
         memcpy(j->all_normals + 3 * (f * j->all_vertices + from), j->normals[s * MAX_POSES + f][i], 12 * j->view[i].vertices);
      }
   return 0;
}
static int write_obj(const job *j)
{
   FILE *f = fopen(j->o.out, "w");
   size_t i, k, from = 0;
   int bad;
   if (!f) return ex_say("%s: %s", j->o.out, strerror(errno));
   for (i = 0; i < j->meshes; i++) {
      fprintf(f, "o %s\n", file_name(i ? j->o.garment[i - 1].path : j->o.body));
      for (k = from; k < from + j->view[i].vertices; k++)
         fprintf(f, "v %.6f %.6f %.6f\nvn %.5f %.5f %.5f\n", (double)j->all[3 * k], (double)j->all[3 * k + 1], (double)j->all[3 * k + 2],
                 (double)j->all_normals[3 * k], (double)j->all_normals[3 * k + 1], (double)j->all_normals[3 * k + 2]);
      for (k = 0; k < j->view[i].triangles; k++) {
         const uint32_t *t = j->view[i].triangle + 3 * k;
         size_t a = from + t[0] + 1, b = from + t[1] + 1, c = from + t[2] + 1;
         fprintf(f, "f %zu//%zu %zu//%zu %zu//%zu\n", a, a, b, b, c, c);
      }
      from += j->view[i].vertices;
   }
   bad = ferror(f);
   bad |= fclose(f) != 0;
   if (bad) remove(j->o.out);
   return bad ? ex_say("%s: cannot be written", j->o.out) : 0;
}
static int write_glb(const job *j)
{
   char error[EX_ERROR];
   ex_baked b;
   size_t f;
   memset(&b, 0, sizeof b);
   for (f = 0; f < j->stance_count; f++) j->times[f] = j->stances[f].time;
   b.name = "dressed";
   b.vertices = j->all_vertices, b.triangles = j->all_triangles, b.frames = j->stance_count;
   b.triangle = j->all_triangle, b.positions = j->all, b.normals = j->all_normals, b.times = j->times;
   return ex_write_glb(j->o.out, &b, error) ? 0 : ex_say("%s", error);
}
static int write_picture(const job *j)
{
   size_t rows = (size_t)j->o.shapes, columns = j->stance_count < MAX_POSES ? j->stance_count : MAX_POSES, s, f, i;
   ex_panel *panel = (ex_panel *)ex_take(rows * columns, sizeof *panel);
   ex_part *part = (ex_part *)ex_take(rows * columns * j->meshes, sizeof *part);
   char (*caption)[64] = (char (*)[64])ex_take(rows, 64);
   char title[256];
   const char *why = "out of memory";
   size_t used = (size_t)snprintf(title, sizeof title, "body");
   for (i = 0; i < (size_t)j->o.garments && used < sizeof title; i++) {
      const char *name = file_name(j->o.garment[i].path);
      used += (size_t)snprintf(title + used, sizeof title - used, "%s%.*s", i ? " + " : " in ", (int)strcspn(name, "."), name);
   }
   if (panel && part && caption) {
      for (s = 0; s < rows; s++) {
         size_t at = (size_t)snprintf(caption[s], 64, j->o.betas[s] ? "shape" : "average shape");
         for (i = 0; i < (size_t)j->o.betas[s] && at < 56; i++) at += (size_t)snprintf(caption[s] + at, 64 - at, " %.3g", (double)j->o.beta[s][i]);
         for (f = 0; f < columns; f++) {
            ex_panel *p = panel + s * columns + f;
            p->title = j->stances[f].title, p->caption = caption[s];
            p->part = part + (s * columns + f) * j->meshes, p->parts = j->meshes;
            p->turn = 0.5f;
            for (i = 0; i < j->meshes; i++) {
               ex_part *q = part + (s * columns + f) * j->meshes + i;
               q->vertices = j->view[i].vertices, q->triangles = j->view[i].triangles, q->triangle = j->view[i].triangle;
               q->positions = j->positions[s * MAX_POSES + f][i], q->normals = j->normals[s * MAX_POSES + f][i];
               q->colour = i ? cloth_colours[i - 1] : skin_colour;
            }
         }
      }
      why = ex_panels(j->o.picture, title, panel, rows, columns);
   }
   free(panel), free(part), free(caption);
   return why ? ex_say("%s: %s", j->o.picture, why) : 0;
}
static int run(job *j)
{
   size_t s, f, i;
   if (open_all(j)) return 1;
   for (s = 0; s < (size_t)j->o.shapes; s++) {
      dn_collision worst[MESHES];
      double ms = 0, total = 0, changed = 0;
      memset(worst, 0, sizeof worst);
      if (s) { /* the slider's call */
         dn_dressed_changes c;
         dn_error e;
         memset(&c, 0, sizeof c);
         c.beta = j->o.beta[s], c.betas = (size_t)j->o.betas[s], c.parallel = &j->parallel;
         changed = ex_now_ms();
         if (dn_dressed_change(j->dressed, &c, j->change, j->change_bytes, &e) != DN_OK) return ex_say_error("--shape", &e);
         changed = ex_now_ms() - changed;
      }
      for (f = 0; f < j->stance_count; f++) {
         if (run_frame(j, s, f, &ms, worst)) return 1;
         total += ms;
      }
      printf("shape %zu: ", s);
      if (s) printf("changed in %.1f ms; ", changed);
      printf("%zu poses, %.1f ms each on %u threads\n", j->stance_count, total / (double)j->stance_count, j->o.threads);
      for (i = 1; i < j->meshes; i++)
         printf("  %-22s %zu of %zu vertices moved out, %zu from inside, at most %.1f mm deep; %zu squeezed%s\n", file_name(j->o.garment[i - 1].path),
                worst[i].moved, j->view[i].vertices * j->stance_count, worst[i].inside, (double)worst[i].deepest * 1e3, worst[i].squeezed,
                worst[i].squeezed ? " between two surfaces" : "");
   }
   if (j->o.out && (ex_ends_with(j->o.out, ".obj") ? write_obj(j) : write_glb(j))) return 1;
   if (j->o.picture && write_picture(j)) return 1;
   if (j->o.out) printf("%s\n", j->o.out);
   if (j->o.picture) printf("%s\n", j->o.picture);
   return 0;
}
int main(int argc, char **argv)
{
   static job j; /* the options alone are some kilobytes */
   size_t i, k;
   int bad;
   ex_program("wardrobe");
   if (argc == 1) {
      fputs(usage, stdout);
      return 1;
   }
   bad = read_options(&j.o, argc, argv) || run(&j);
   for (i = 0; i < MAX_SHAPES * MAX_POSES; i++)
      for (k = 0; k < MESHES; k++) free(j.positions[i][k]), free(j.normals[i][k]);
   for (i = 0; i < j.stance_count; i++) free(j.stances[i].rotations), free(j.stances[i].theta);
   free(j.stances), free(j.block), free(j.change_block), free(j.all), free(j.all_normals), free(j.all_triangle), free(j.times);
   dn_dressed_free(j.dressed);
   for (i = 0; i < MESHES; i++) dn_shape_free(j.shape[i]);
   for (i = 0; i < MAX_GARMENTS; i++) free(j.o.garment[i].path);
   dn_model_free(j.coarse), dn_model_free(j.refine), dn_model_free(j.body_model);
   ex_pool_free(j.pool);
   return bad;
}
