/*  rig.c - an unrigged character becomes a rigged one: skeleton, skin weights and corrective shapes from its mesh alone
    shows     dn_blend of deformnet.h (Neural Blend Shapes): bind once, coefficients and poses per frame, m_j B_i as morph
              targets; a GLB that Blender, engines and viewers play without this library
    not here  reading meshes (common/mesh.h), fitting a motion (common/retarget.h), writing GLB (common/glb.h), training
    build     make rig
    run       ./rig --model nbs.safetensors --mesh tpose.obj --out rigged.glb
              ./rig --model nbs.safetensors --mesh tpose.glb --fit --motion walk.glb --joints mixamo --out walking.glb
    flow      mesh (V,3) --dn_blend--> weights (V,S), joints (S,3), shapes (V,B,3), masks --+
              motion --retarget--> rotations (S,9) a frame --coefficients--> (S-1,B) -------+--> GLB: skin, morph targets,
                                                                                                 keys of joints and weights */
#define _POSIX_C_SOURCE 200809L
#define DEFORMNET_IMPLEMENTATION
#include "../deformnet.h"
#include "common/glb.h"
#include "common/mesh.h"
#include "common/picture.h"
#include "common/pool.h"
#include "common/retarget.h"
#include "common/scene.h"
#include "common/tool.h"
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* ===================================================================================== >>small things */
static const char usage[] =
   "usage: rig --model M.safetensors --mesh T.obj|T.glb --out O.glb [--fit]\n"
   "           [--motion A.glb|A.safetensors] [--animation NAME] [--joints smpl|mixamo|NAME,NAME,..]\n"
   "           [--influences 4|8|..|all] [--weights signed|unsigned] [--threads n] [--picture P.png]\n"
   "  --mesh        in a T-pose, arms along x, y up, facing +z; triangles, or faces that become fans\n"
   "  --fit         the networks see the mesh moved and scaled to the hand span of SMPL's T-pose, on which the published\n"
   "                weights were trained; the rig is made for the mesh as it is\n"
   "  --motion      a clip whose joints are matched by name, or a tensor axis_angle [frames,joints,3]\n"
   "  --joints      names for the model's joints, by which motions match; without it the model's own\n"
   "  --influences  skin weights of a vertex that are kept, the largest (4, which every viewer reads)\n"
   "  --weights     unsigned: morph weights between 0 and 1 (Blender's sliders end there), two targets where the motion\n"
   "                needs both signs; the default with a motion. signed: the networks' coefficients themselves\n";
static const char joints_smpl[] =
   "pelvis,left_hip,right_hip,spine1,left_knee,right_knee,spine2,left_ankle,right_ankle,spine3,left_foot,right_foot,neck,left_collar,"
   "right_collar,head,left_shoulder,right_shoulder,left_elbow,right_elbow,left_wrist,right_wrist,left_hand,right_hand";
static const char joints_mixamo[] =
   "Hips,LeftUpLeg,RightUpLeg,Spine,LeftLeg,RightLeg,Spine1,LeftFoot,RightFoot,Spine2,LeftToeBase,RightToeBase,Neck,LeftShoulder,"
   "RightShoulder,Head,LeftArm,RightArm,LeftForeArm,RightForeArm,LeftHand,RightHand,LeftHandMiddle1,RightHandMiddle1";

static double distance(const float *a, const float *b)
{
   double x = (double)a[0] - (double)b[0], y = (double)a[1] - (double)b[1], z = (double)a[2] - (double)b[2];
   return sqrt(x * x + y * y + z * z);
}

/* ===================================================================================== >>options */
typedef struct options {
   const char *model, *mesh, *out, *motion, *animation, *joints, *picture;
   size_t influences; /* 0: all */
   int fit, is_signed; /* -1: as the motion asks */
   unsigned threads;
} options;

static int read_options(options *o, int argc, char **argv)
{
   int i;
   memset(o, 0, sizeof *o);
   o->influences = 4;
   o->is_signed = -1;
   for (i = 1; i < argc; i++) {
      const char *key = argv[i], *value = i + 1 < argc ? argv[i + 1] : NULL;
      const char **text = strcmp(key, "--model") == 0     ? &o->model
                        : strcmp(key, "--mesh") == 0      ? &o->mesh
                        : strcmp(key, "--out") == 0       ? &o->out
                        : strcmp(key, "--motion") == 0    ? &o->motion
                        : strcmp(key, "--animation") == 0 ? &o->animation
                        : strcmp(key, "--joints") == 0    ? &o->joints
                        : strcmp(key, "--picture") == 0   ? &o->picture
                                                          : NULL;
      char *rest;
      long n;
      if (strcmp(key, "--help") == 0 || strcmp(key, "-h") == 0) {
         fputs(usage, stdout);
         exit(0);
      }
      if (strcmp(key, "--fit") == 0) {
         o->fit = 1;
         continue;
      }
      if (!text && strcmp(key, "--influences") != 0 && strcmp(key, "--weights") != 0 && strcmp(key, "--threads") != 0)
         return ex_say("unknown argument \"%s\" (--help lists them)", key);
      if (!value) return ex_say("%s needs a value", key);
      i++;
      n = strtol(value, &rest, 10);
      if (text) *text = value;
      else if (strcmp(key, "--weights") == 0) {
         if (strcmp(value, "signed") != 0 && strcmp(value, "unsigned") != 0) return ex_say("--weights %s: expected signed or unsigned", value);
         o->is_signed = value[0] == 's';
      } else if (strcmp(key, "--threads") == 0) {
         if (*rest || n < 1 || n > 256) return ex_say("--threads %s: expected 1 to 256", value);
         o->threads = (unsigned)n;
      } else if (strcmp(value, "all") == 0) o->influences = 0;
      else {
         if (*rest || n < 4 || n > 60 || n % 4) return ex_say("--influences %s: expected 4, 8, 12 .. 60 or all", value);
         o->influences = (size_t)n;
      }
   }
   if (!o->mesh || !o->out) return ex_say("needs --mesh and --out (--help lists all)");
   if (!o->model)
      return ex_say("needs --model: no trained weights ship yet; examples/train/convert_nbs.py makes a model from the published checkpoint");
   if (strlen(o->out) < 4 || strcmp(o->out + strlen(o->out) - 4, ".glb") != 0) return ex_say("--out %s: expected a name ending in .glb", o->out);
   if (o->picture && !o->motion) return ex_say("--picture shows a frame of a motion: give --motion");
   if (!o->threads) o->threads = ex_processors();
   return 0;
}

/* ===================================================================================== >>job */
typedef struct job {
   options o;
   ex_mesh *mesh;
   dn_model *model;
   dn_model_info info;
   ex_pool *pool;
   dn_parallel parallel;
   double hand_span, hand_height;
   float scale, lift;          /* --fit: what the networks see is (x - lift along y) / scale */
   float *seen;                /* (V,3) that */
   dn_blend *blend;
   dn_blend_view view;
   char *name_text;
   const char **names;         /* (S) */
   float *joint_rest;          /* (S,3) of the mesh as it is */
   float *normals;             /* (V,3) */
   ex_turns *turns;
   void *scratch;
   size_t scratch_bytes;
   size_t influences;
   uint32_t *skin_joints;      /* (V,I) */
   float *skin_weights;        /* (V,I) */
   double kept_mean, kept_least; /* share of a vertex's weights among the largest I */
   size_t coefficients;        /* (S-1) B */
   float *alpha;               /* (F+1, coefficients): the rest pose, then the frames */
   ex_target *target;
   size_t targets, empty, both_signs;
   size_t *target_of;          /* (targets) coefficient */
   float *target_scale;        /* (targets) alpha of weight 1 */
   uint32_t *lists;            /* of all joints */
   float *offsets;             /* of all targets */
   char *target_names;
   float *quaternions, *travel, *weights; /* (F,S,4), (F,3), (F,targets) */
   double *ms;                 /* (F) */
   double ms_bind, moved_mean, moved_max, apart_mean, apart_max;
   size_t shown;               /* the frame with the largest displacement */
   size_t bytes;
} job;

/* ===================================================================================== >>bind */
static int show_progress(void *user, const char *stage, float done)
{
   (void)user;
   fprintf(stderr, "\r%-24.24s %3.0f %%  %s", stage, (double)(done * 100), done >= 1 ? "\r                                \r" : "");
   return 0;
}

/*  Hands of SMPL's T-pose, the vertices farthest along x: 0.8356 0.2134 and -0.8349 0.2105 metres, the pelvis near 0.
    The networks were trained on meshes placed like it. */
static const double span = 0.8356 + 0.8349, height = (0.2134 + 0.2105) / 2;
static int place(job *j)
{
   const float *x = j->mesh->positions;
   size_t left = 0, right = 0, v, k;
   double wide, hands;
   j->scale = 1;
   for (v = 1; v < j->mesh->vertices; v++) {
      if (x[3 * v] > x[3 * left]) left = v;
      if (x[3 * v] < x[3 * right]) right = v;
   }
   wide = (double)x[3 * left] - (double)x[3 * right];
   hands = ((double)x[3 * left + 1] + (double)x[3 * right + 1]) / 2;
   j->hand_span = wide;
   j->hand_height = hands;
   if (!j->o.fit) return 0;
   if (!(wide > 1e-6)) return ex_say("%s: has no width along x to fit", j->o.mesh);
   j->scale = (float)(wide / span);
   j->lift = (float)(hands - height * (double)j->scale);
   for (v = 0; v < j->mesh->vertices; v++)
      for (k = 0; k < 3; k++) j->seen[3 * v + k] = (x[3 * v + k] - (k == 1 ? j->lift : 0)) / j->scale;
   return 0;
}

static int bind(job *j)
{
   dn_blend_desc d;
   dn_progress progress;
   dn_error err;
   double t0;
   size_t k;
   memset(&d, 0, sizeof d);
   memset(&progress, 0, sizeof progress);
   memset(&err, 0, sizeof err);
   j->seen = (float *)ex_take(j->mesh->vertices, 3 * sizeof(float));
   if (!j->seen) return ex_say("out of memory");
   memcpy(j->seen, j->mesh->positions, j->mesh->vertices * 3 * sizeof(float));
   if (place(j)) return 1;
   progress.step = show_progress;
   d.mesh.vertices = j->mesh->vertices;
   d.mesh.positions = j->seen;
   d.mesh.triangles = j->mesh->triangles;
   d.mesh.indices = j->mesh->triangle;
   d.mesh.index_type = DN_U32;
   d.parallel = &j->parallel;
   d.progress = isatty(2) ? &progress : NULL;
   t0 = ex_now_ms();
   j->blend = dn_blend_create(j->model, &d, NULL, &err);
   if (!j->blend) return ex_say_error(err.code == DN_BAD_MESH ? j->o.mesh : j->o.model, &err);
   j->ms_bind = ex_now_ms() - t0;
   dn_blend_describe(j->blend, &j->view);
   j->coefficients = (j->view.joints - 1) * j->view.shapes;
   j->joint_rest = (float *)ex_take(j->view.joints, 3 * sizeof(float));
   if (!j->joint_rest) return ex_say("out of memory");
   for (k = 0; k < 3 * j->view.joints; k++) j->joint_rest[k] = j->view.joint_rest[k] * j->scale + (k % 3 == 1 ? j->lift : 0);
   j->scratch = dn_blend_scratch_create(j->blend, NULL, &j->scratch_bytes, &err);
   return j->scratch ? 0 : ex_say_error(j->o.mesh, &err);
}

static int name_joints(job *j)
{
   const char *list = j->o.joints;
   size_t s, n = j->view.joints, size;
   char *at;
   if (list && strcmp(list, "smpl") == 0) list = joints_smpl;
   if (list && strcmp(list, "mixamo") == 0) list = joints_mixamo;
   size = (list ? strlen(list) : 0) + 24 * n + 1;
   j->names = (const char **)ex_take(n, sizeof *j->names);
   j->name_text = at = (char *)ex_take(size, 1);
   if (!j->names || !at) return ex_say("out of memory");
   if (!list) {
      for (s = 0; s < n; s++) {
         if (j->view.joint_names) j->names[s] = j->view.joint_names[s];
         else j->names[s] = at, at += snprintf(at, 24, "joint%lu", (unsigned long)s) + 1;
      }
      return 0;
   }
   memcpy(at, list, strlen(list) + 1);
   for (s = 0; at && *at; s++) {
      char *comma = strchr(at, ',');
      if (comma) *comma = 0;
      if (s < n) j->names[s] = at;
      at = comma ? comma + 1 : NULL;
   }
   return s == n ? 0 : ex_say("--joints: %lu names, the model has %lu joints", (unsigned long)s, (unsigned long)n);
}

/* the file's normals, or smooth ones over welded vertices */
static int make_normals(job *j)
{
   size_t n = j->view.nodes, i;
   float *node = (float *)ex_take(n, 3 * sizeof(float));
   uint32_t *triangle = (uint32_t *)ex_take(j->mesh->triangles, 3 * sizeof *triangle);
   j->normals = (float *)ex_take(j->mesh->vertices, 3 * sizeof(float));
   if (node && triangle && j->normals) {
      if (j->mesh->normals) memcpy(j->normals, j->mesh->normals, j->mesh->vertices * 3 * sizeof(float));
      else {
         for (i = 0; i < 3 * j->mesh->triangles; i++) triangle[i] = j->view.node_of_vertex[j->mesh->triangle[i]];
         dn_normals(j->view.rest, n, triangle, j->mesh->triangles, node);
         for (i = 0; i < j->mesh->vertices; i++) memcpy(j->normals + 3 * i, node + 3 * (size_t)j->view.node_of_vertex[i], 3 * sizeof(float));
      }
   }
   i = node && triangle && j->normals;
   free(node);
   free(triangle);
   return i ? 0 : ex_say("out of memory");
}

/* ===================================================================================== >>skin */
static int make_skin(job *j)
{
   size_t s = j->view.joints, v, k, a, wide = j->o.influences ? j->o.influences : (s + 3) / 4 * 4;
   double sum_kept = 0;
   if (wide > (s + 3) / 4 * 4) wide = (s + 3) / 4 * 4;
   if (wide > 60) return ex_say("--influences all: glTF's readers do not take %lu", (unsigned long)wide);
   j->influences = wide;
   j->kept_least = 1;
   j->skin_joints = (uint32_t *)ex_take(j->mesh->vertices, wide * sizeof *j->skin_joints);
   j->skin_weights = (float *)ex_take(j->mesh->vertices, wide * sizeof *j->skin_weights);
   if (!j->skin_joints || !j->skin_weights) return ex_say("out of memory");
   for (v = 0; v < j->mesh->vertices; v++) {
      const float *w = j->view.skin_weight + s * j->view.node_of_vertex[v];
      uint32_t *joint = j->skin_joints + v * wide;
      float *weight = j->skin_weights + v * wide, rest = 1;
      double all = 0, kept = 0;
      for (k = 0; k < s; k++) { /* insertion keeps the largest in falling order, the earlier joint of two equal ones */
         all += (double)w[k];
         if (!(w[k] > weight[wide - 1])) continue;
         for (a = wide - 1; a > 0 && w[k] > weight[a - 1]; a--) weight[a] = weight[a - 1], joint[a] = joint[a - 1];
         weight[a] = w[k], joint[a] = (uint32_t)k;
      }
      for (k = 0; k < wide; k++) kept += (double)weight[k];
      if (!(kept > 0)) weight[0] = 1, joint[0] = 0, kept = all = 1;
      sum_kept += kept / all;
      if (kept / all < j->kept_least) j->kept_least = kept / all;
      for (k = 0; k < wide; k++) {
         weight[k] = (float)((double)weight[k] / kept);
         if (weight[k] < 1e-7f) weight[k] = 0, joint[k] = 0; /* below what their sum can hold */
         if (k) rest -= weight[k];
      }
      weight[0] = rest; /* so that the floats add up to one */
   }
   j->kept_mean = sum_kept / (double)j->mesh->vertices;
   return 0;
}

/* ===================================================================================== >>frames */
/* what a viewer computes from the file, and what the library does: their distance is what fewer influences cost */
static void compare(job *j, const float *palette, const float *displacement, const float *positions)
{
   size_t v, k, c, i = j->influences;
   double sum = 0;
   for (v = 0; v < j->mesh->vertices; v++) {
      float m[12], x[3], y[3];
      double d;
      memset(m, 0, sizeof m);
      for (k = 0; k < i; k++)
         for (c = 0; c < 12; c++) m[c] += j->skin_weights[v * i + k] * palette[12 * (size_t)j->skin_joints[v * i + k] + c];
      for (c = 0; c < 3; c++) x[c] = j->seen[3 * v + c] + displacement[3 * v + c];
      for (c = 0; c < 3; c++) y[c] = m[4 * c] * x[0] + m[4 * c + 1] * x[1] + m[4 * c + 2] * x[2] + m[4 * c + 3];
      d = distance(y, positions + 3 * v) * (double)j->scale;
      sum += d;
      if (d > j->apart_max) j->apart_max = d;
   }
   j->apart_mean += sum / (double)j->mesh->vertices;
}

static int run_frames(job *j, dn_error *err)
{
   size_t s = j->view.joints, frames = j->turns ? j->turns->frames : 0, v = j->mesh->vertices, f, i, k;
   float *block = (float *)ex_take(v, 6 * sizeof(float)), *palette = (float *)ex_take(s, 12 * sizeof(float));
   const float zero[3] = {0, 0, 0};
   int bad = 1;
   dn_blend_input in;
   dn_blend_output out;
   j->alpha = (float *)ex_take(frames + 1, j->coefficients * sizeof *j->alpha);
   j->quaternions = (float *)ex_take(frames, s * 4 * sizeof *j->quaternions);
   j->travel = (float *)ex_take(frames, 3 * sizeof *j->travel);
   j->ms = (double *)ex_take(frames, sizeof *j->ms);
   if (!block || !palette || !j->alpha || !j->quaternions || !j->travel || !j->ms) {
      ex_say("out of memory");
      goto end;
   }
   memset(&in, 0, sizeof in);
   memset(&out, 0, sizeof out);
   in.strength = 1;
   out.coefficients = j->alpha;
   if (dn_blend_pose(j->blend, &in, &out, j->scratch, j->scratch_bytes, &j->parallel, err) != DN_OK) goto failed;
   out.positions = block;
   for (f = 0; f < frames; f++) {
      double t0, sum = 0;
      in.rotations = j->turns->rotations + 9 * f * s;
      out.coefficients = j->alpha + (f + 1) * j->coefficients;
      t0 = ex_now_ms();
      if (dn_blend_pose(j->blend, &in, &out, j->scratch, j->scratch_bytes, &j->parallel, err) != DN_OK) goto failed;
      j->ms[f] = ex_now_ms() - t0;
      out.displacement = block + 3 * v; /* once more for the report, not timed */
      out.palette = palette;
      dn_blend_pose(j->blend, &in, &out, j->scratch, j->scratch_bytes, &j->parallel, NULL);
      compare(j, palette, out.displacement, block);
      for (i = 0; i < v; i++) {
         double d = distance(out.displacement + 3 * i, zero) * (double)j->scale;
         sum += d;
         if (d > j->moved_max) j->moved_max = d, j->shown = f;
      }
      j->moved_mean += sum / (double)v / (double)frames;
      out.displacement = out.palette = NULL;
      for (i = 0; i < s; i++) { /* of q and -q the one nearer to the frame before, so that keys blend the short way */
         float *q = j->quaternions + 4 * (f * s + i), dot = 0;
         ex_quaternion(in.rotations + 9 * i, q);
         for (k = 0; k < 4 && f; k++) dot += q[k] * q[k - 4 * s];
         for (k = 0; k < 4 && dot < 0; k++) q[k] = -q[k];
      }
      for (k = 0; k < 3; k++) j->travel[3 * f + k] = j->joint_rest[k] + j->turns->travel[3 * f + k];
   }
   if (frames) j->apart_mean /= (double)frames;
   bad = 0;
   goto end;
failed:
   ex_say_error(j->turns ? j->o.motion : j->o.model, err);
end:
   free(block);
   free(palette);
   return bad;
}

/* ===================================================================================== >>targets */
/*  One target m_j B_i for each coefficient, of the vertices it moves; none where it moves none. signed: its weight is the
    coefficient. unsigned: it is divided by the largest coefficient of its sign over the motion and the rest pose, and where
    both signs occur there are two targets, of which one is always at 0. */
static void range_of(const job *j, size_t c, float *lo, float *hi)
{
   size_t f, frames = (j->turns ? j->turns->frames : 0) + 1;
   *lo = *hi = 0;
   for (f = 0; f < frames; f++) {
      float a = j->alpha[f * j->coefficients + c];
      if (a < *lo) *lo = a;
      if (a > *hi) *hi = a;
   }
}
static float weight_of(const job *j, size_t target, size_t frame) /* 0: the rest pose */
{
   float a = j->alpha[frame * j->coefficients + j->target_of[target]], s = j->target_scale[target];
   if (j->o.is_signed) return a;
   a /= s;
   return a > 0 ? (a < 1 ? a : 1) : 0;
}
static int make_targets(job *j)
{
   size_t V = j->mesh->vertices, B = j->view.shapes, c, v, k, total = 0, kept = 0, room = 2 * j->coefficients, frames = j->turns ? j->turns->frames : 0;
   size_t *moves = (size_t *)ex_take(j->coefficients, sizeof *moves), name_size = 0;
   float *row = (float *)ex_take(V, 3 * sizeof *row), *offset;
   uint32_t *list;
   char *name;
   int bad = 1;
   for (c = 1; c < j->view.joints; c++) name_size += 2 * B * (strlen(j->names[c]) + 24);
   j->target = (ex_target *)ex_take(room, sizeof *j->target);
   j->target_of = (size_t *)ex_take(room, sizeof *j->target_of);
   j->target_scale = (float *)ex_take(room, sizeof *j->target_scale);
   j->target_names = name = (char *)ex_take(name_size + 1, 1);
   if (!moves || !row || !j->target || !j->target_of || !j->target_scale || !name) goto memory;
   for (c = 0; c < j->coefficients; c++) {
      float lo, hi;
      moves[c] = dn_blend_morph(j->blend, c / B + 1, c % B, NULL, 0);
      if (!moves[c]) { j->empty++; continue; }
      range_of(j, c, &lo, &hi);
      total += moves[c] * (!j->o.is_signed && lo < 0 && hi > 0 ? 2 : 1);
      kept += moves[c];
   }
   j->offsets = offset = (float *)ex_take(total, 3 * sizeof *offset);
   j->lists = list = (uint32_t *)ex_take(kept, sizeof *list);
   if (!offset || !list) goto memory;
   for (c = 0; c < j->coefficients; c++) {
      const uint32_t *mine = list;
      float lo, hi, scale[2];
      size_t n = 0, passes = 1, pass;
      if (!moves[c]) continue;
      dn_blend_morph(j->blend, c / B + 1, c % B, row, 0);
      for (v = 0; v < V; v++) if (row[3 * v] != 0 || row[3 * v + 1] != 0 || row[3 * v + 2] != 0) list[n++] = (uint32_t)v;
      /* the shapes of one joint mostly move the same vertices, and then share the list */
      if (j->targets && j->target[j->targets - 1].count == n && memcmp(j->target[j->targets - 1].at, list, n * sizeof *list) == 0) mine = j->target[j->targets - 1].at;
      else list += n;
      range_of(j, c, &lo, &hi);
      scale[0] = 1;
      if (!j->o.is_signed) {
         scale[0] = hi > 0 ? hi : lo < 0 ? lo : 1;
         scale[1] = lo;
         if (hi > 0 && lo < 0) passes = 2, j->both_signs++;
      }
      for (pass = 0; pass < passes; pass++) {
         ex_target *t = j->target + j->targets;
         j->target_of[j->targets] = c;
         j->target_scale[j->targets] = scale[pass];
         t->name = name;
         name += sprintf(name, "%s.%lu%s", j->names[c / B + 1], (unsigned long)(c % B), passes == 1 ? "" : pass ? "-" : "+") + 1;
         t->count = n;
         t->at = mine;
         t->offset = offset;
         for (v = 0; v < n; v++) for (k = 0; k < 3; k++) *offset++ = row[3 * (size_t)mine[v] + k] * scale[pass] * j->scale;
         t->rest = weight_of(j, j->targets++, 0);
      }
   }
   j->weights = (float *)ex_take(frames, j->targets * sizeof *j->weights);
   if (!j->weights) goto memory;
   for (v = 0; v < frames; v++) for (c = 0; c < j->targets; c++) j->weights[v * j->targets + c] = weight_of(j, c, v + 1);
   bad = 0;
memory:
   free(moves);
   free(row);
   return bad ? ex_say("out of memory") : 0;
}

/* ===================================================================================== >>results */
static int write_character(job *j)
{
   char error[EX_ERROR];
   const char *slash = strrchr(j->o.mesh, '/');
   ex_rig r;
   memset(&r, 0, sizeof r);
   r.name = slash ? slash + 1 : j->o.mesh;
   r.vertices = j->mesh->vertices;
   r.triangles = j->mesh->triangles;
   r.influences = j->influences;
   r.joints = j->view.joints;
   r.targets = j->targets;
   r.positions = j->mesh->positions;
   r.normals = j->normals;
   r.uv = j->mesh->uv;
   r.triangle = j->mesh->triangle;
   r.skin_joints = j->skin_joints;
   r.skin_weights = j->skin_weights;
   r.names = j->names;
   r.parents = j->view.parents;
   r.joint_rest = j->joint_rest;
   r.target = j->target;
   if (j->turns) {
      r.frames = j->turns->frames;
      r.motion = j->turns->name;
      r.times = j->turns->times;
      r.turns = j->quaternions;
      r.travel = j->travel;
      r.weights = j->weights;
   }
   return ex_write_rig(j->o.out, &r, &j->bytes, error) ? 0 : ex_say("%s", error);
}

static int write_picture(job *j)
{
   size_t v = j->mesh->vertices, i, k;
   float *block = (float *)ex_take(v, 16 * sizeof(float)), *at[4], *value;
   const float zero[3] = {0, 0, 0};
   const char *why = "out of memory";
   char title[160], caption[96];
   ex_comparison c;
   ex_shape shape[2];
   dn_blend_input in;
   dn_blend_output out;
   if (!block) return ex_say("%s: %s", j->o.picture, why);
   for (i = 0; i < 4; i++) at[i] = block + 3 * v * i;
   value = block + 12 * v;
   memset(&c, 0, sizeof c);
   memset(shape, 0, sizeof shape);
   memset(&in, 0, sizeof in);
   memset(&out, 0, sizeof out);
   in.rotations = j->turns->rotations + 9 * j->shown * j->view.joints;
   for (i = 0; i < 2; i++) {
      in.strength = (float)i;
      out.positions = at[i];
      out.displacement = at[3];
      dn_blend_pose(j->blend, &in, &out, j->scratch, j->scratch_bytes, &j->parallel, NULL);
      for (k = 0; k < 3 * v; k++) at[i][k] *= j->scale;
   }
   for (k = 0; k < v; k++) value[k] = (float)(distance(at[3] + 3 * k, zero) * (double)j->scale);
   for (i = 0; i < 2; i++) {
      float *n = at[2 + i];
      ex_normals(v, at[i], j->mesh->triangles, j->mesh->triangle, n);
      shape[i].positions = at[i];
      shape[i].normals = n;
   }
   shape[0].title = "Predicted rig, plain skinning";
   shape[1].title = "With corrective shapes";
   shape[1].value = value;
   snprintf(caption, sizeof caption, "moved by %.2f cm on average, %.1f cm at most", 100 * j->moved_mean, 100 * j->moved_max);
   shape[1].caption = caption;
   snprintf(title, sizeof title, "%.100s, frame %lu: where the shapes move most", j->turns->name, (unsigned long)j->shown);
   c.title = title;
   c.scale_title = "moved by the corrective shapes";
   c.vertices = v;
   c.triangles = j->mesh->triangles;
   c.triangle = j->mesh->triangle;
   c.shapes = 2;
   c.shape = shape;
   c.looked_at = 1;
   why = ex_compare(j->o.picture, &c);
   free(block);
   return why ? ex_say("%s: %s", j->o.picture, why) : 0;
}

static void print_report(job *j)
{
   const double mb = 1.0 / (1024 * 1024);
   size_t frames = j->turns ? j->turns->frames : 0;
   printf("model       %s: %zu parameters, %zu joints, %zu shapes a joint\n", j->o.model, j->info.parameters, j->view.joints, j->view.shapes);
   printf("mesh        %s: %zu vertices, %zu nodes, %zu edges", j->o.mesh, j->view.vertices, j->view.nodes, j->view.edges);
   if (j->mesh->skinned) printf("; its own skin is ignored");
   if (j->view.isolated_nodes) printf("; %zu nodes without edges stay on joint 0", j->view.isolated_nodes);
   if (j->view.skipped_triangles) printf("; %zu triangles give the networks nothing", j->view.skipped_triangles);
   if (j->o.fit) printf("\nfit         seen by the networks at 1/%.4g of its size, lowered by %.4g", (double)j->scale, (double)j->lift);
   else if (fabs(j->hand_span / span - 1) > 0.25 || fabs(j->hand_height - height) > 0.25 * span)
      printf("\nplacement   hand span %.3g at height %.3g, SMPL's T-pose %.2f at %.2f: for a model trained on that, give --fit", j->hand_span,
             j->hand_height, span, height);
   printf("\nbind        %.0f ms, once (%u thread%s, %s)\n", j->ms_bind, j->parallel.workers ? j->parallel.workers : 1, j->parallel.workers > 1 ? "s" : "", dn_kernel_name(DN_KERNEL_AUTO));
   printf("skin        %zu of %zu influences a vertex: they hold %.2f %% of its weights on average, %.1f %% at least\n", j->influences,
          j->view.joints, 100 * j->kept_mean, 100 * j->kept_least);
   printf("targets     %zu of %zu shapes%s", j->targets, j->coefficients, j->o.is_signed ? "" : ", weights 0 .. 1");
   if (j->empty) printf("; %zu move nothing", j->empty);
   if (j->both_signs) printf("; %zu are there twice, once for each sign", j->both_signs);
   printf("\n");
   if (frames) {
      printf("motion      %s: %zu frames, %zu of %zu joints moved", j->turns->name, frames, j->turns->matched, j->view.joints);
      if (j->turns->bridged) printf(", %zu bones brought from another rest pose", j->turns->bridged);
      printf("\nper frame   %.3f ms: coefficients, shapes and skinning (median)\n", ex_median(j->ms, frames));
      printf("shapes      move the vertices by %.3f cm on average, %.2f cm at most\n", 100 * j->moved_mean, 100 * j->moved_max);
      printf("file        what it shows differs from deformnet.h by %.4f cm on average, %.3f cm at most\n", 100 * j->apart_mean, 100 * j->apart_max);
   }
   printf("wrote       %s: %.2f MB\n", j->o.out, (double)j->bytes * mb);
   if (j->o.picture) printf("wrote       %s\n", j->o.picture);
}

/* ===================================================================================== >>main */
static int run(job *j, int argc, char **argv)
{
   char error[EX_ERROR];
   dn_error err;
   memset(&err, 0, sizeof err);
   if (read_options(&j->o, argc, argv)) return 1;
   j->mesh = ex_mesh_load(j->o.mesh, error);
   if (!j->mesh) return ex_say("%s", error);
   j->model = dn_model_load_file(j->o.model, NULL, NULL, &err);
   if (!j->model) return ex_say_error(j->o.model, &err);
   dn_model_describe(j->model, &j->info);
   if (j->o.threads > 1 && !(j->pool = ex_pool_create(j->o.threads))) return ex_say("cannot start %u threads", j->o.threads);
   j->parallel = ex_pool_parallel(j->pool);
   if (bind(j) || name_joints(j) || make_normals(j) || make_skin(j)) return 1;
   if (j->o.motion) {
      ex_skeleton s;
      s.joints = j->view.joints;
      s.names = j->names;
      s.parents = j->view.parents;
      s.rest = j->joint_rest;
      j->turns = ex_turns_load(j->o.motion, j->o.animation, &s, error);
      if (!j->turns) return ex_say("%s", error);
   }
   if (j->o.is_signed < 0) j->o.is_signed = j->turns == NULL;
   if (run_frames(j, &err) || make_targets(j) || write_character(j)) return 1;
   if (j->o.picture && write_picture(j)) return 1;
   print_report(j);
   return 0;
}

int main(int argc, char **argv)
{
   job j;
   int code;
   ex_program("rig");
   memset(&j, 0, sizeof j);
   code = run(&j, argc, argv);
   free(j.seen), free(j.name_text), free(j.names), free(j.joint_rest), free(j.normals), free(j.skin_joints), free(j.skin_weights);
   free(j.alpha), free(j.target), free(j.target_of), free(j.target_scale), free(j.lists), free(j.offsets), free(j.target_names);
   free(j.quaternions), free(j.travel), free(j.weights), free(j.ms);
   dn_scratch_free(j.scratch, j.scratch_bytes, NULL);
   dn_blend_free(j.blend);
   ex_turns_free(j.turns);
   ex_pool_free(j.pool);
   ex_mesh_free(j.mesh);
   dn_model_free(j.model);
   return code;
}
