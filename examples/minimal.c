/*  minimal.c - bend a tube, and let a network give back the volume that skinning loses
    shows     load a model, bind once, deform per frame, report errors
    not here  characters from files, threads, timing (refine.c); training (train/tiny.py made the model)
    build     cc -O2 minimal.c -o minimal -lm
    run       ./minimal [models/tiny.safetensors]     prints volume and thickness for five bends
    flow      model file ------load----> dn_model --+
              tube mesh, two joints --bind--> dn_rig --+--deform(palette)--> positions (V,3) */
#define DEFORMNET_IMPLEMENTATION
#include "../deformnet.h"
#include <math.h>
#include <stdio.h>

enum { RINGS = 49, SIDES = 24, V = RINGS * SIDES + 2, T = 2 * RINGS * SIDES };
static float rest[V][3], weight[V][2], posed[V][3];
static uint8_t joint[V][2];
static uint16_t triangle[T][3];
static const float length = 0.6f, radius = 0.05f, elbow = 0.3f, blend = 0.15f; /* metres */

static size_t corner(size_t t, size_t a, size_t b, size_t c)
{
   triangle[t][0] = (uint16_t)a, triangle[t][1] = (uint16_t)b, triangle[t][2] = (uint16_t)c;
   return t + 1;
}

static void build_tube(void) /* along y, closed at both ends; joint 0 below the elbow, joint 1 above, a smooth step between */
{
   size_t v, r, s, t = 0;
   for (v = 0; v < V; v++) {
      float turn = 6.2831853f * (float)(v % SIDES) / SIDES, u;
      rest[v][1] = v < V - 2 ? length * (float)(v / SIDES) / (RINGS - 1) : v == V - 2 ? 0 : length;
      rest[v][0] = v < V - 2 ? radius * cosf(turn) : 0;
      rest[v][2] = v < V - 2 ? radius * sinf(turn) : 0;
      u = fminf(fmaxf((rest[v][1] - elbow) / (2 * blend) + 0.5f, 0), 1);
      weight[v][1] = u * u * (3 - 2 * u);
      weight[v][0] = 1 - weight[v][1];
      joint[v][1] = 1;
   }
   for (r = 0; r < RINGS; r++)
      for (s = 0; s < SIDES; s++) {
         size_t a = r * SIDES + s, b = r * SIDES + (s + 1) % SIDES;
         if (r + 1 < RINGS) t = corner(t, a, a + SIDES, b), t = corner(t, b, a + SIDES, b + SIDES);
         if (r == 0) t = corner(t, V - 2, a, b);
         if (r + 1 == RINGS) t = corner(t, V - 1, b, a);
      }
}

static double volume(float (*p)[3]) /* of the closed surface: a tetrahedron to the origin for each triangle */
{
   double sum = 0;
   size_t t;
   for (t = 0; t < T; t++) {
      const float *a = p[triangle[t][0]], *b = p[triangle[t][1]], *c = p[triangle[t][2]];
      sum += (double)(a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0]));
   }
   return sum / 6;
}

static double across(const float *a, const float *b)
{
   float x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
   return (double)sqrtf(x * x + y * y + z * z);
}

int main(int argc, char **argv)
{
   static const char *const names[2] = { "lower", "upper" };
   static const int32_t parents[2] = { -1, 0 };
   const float inverse_bind[2][12] = { { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0 }, { 1, 0, 0, 0, 0, 1, 0, -elbow, 0, 0, 1, 0 } };
   const char *path = argc > 1 ? argv[1] : "models/tiny.safetensors";
   dn_error err = { 0 };
   dn_rig_desc d = { 0 };
   dn_skin_set skin = { 0 };
   dn_model *model = dn_model_load_file(path, NULL, &err);
   dn_rig *rig = NULL;
   void *scratch = NULL;
   size_t size = 0;
   int degrees;

   build_tube();
   skin.influences = 2;
   skin.joints = joint, skin.joint_type = DN_U8;
   skin.weights = weight, skin.weight_type = DN_F32;
   d.mesh.vertices = V, d.mesh.positions = rest[0];
   d.mesh.triangles = T, d.mesh.indices = triangle, d.mesh.index_type = DN_U16;
   d.mesh.skin_sets = 1, d.mesh.skin = &skin;
   d.skeleton.joints = 2, d.skeleton.names = names, d.skeleton.parents = parents;
   d.skeleton.inverse_bind = inverse_bind[0], d.skeleton.matrix = DN_3X4_ROWS;
   if (model) rig = dn_rig_create(model, &d, NULL, NULL, &err);
   if (rig) scratch = dn_scratch_create(rig, 1, NULL, &size, &err);
   if (!scratch) {
      fprintf(stderr, "%s: %s: %s (%s)\n", path, err.where ? err.where : "minimal", dn_result_text(err.code), err.info);
      return 1;
   }
   printf("bend     volume, %%            thickness at the elbow, %%\n         skinned   refined    skinned   refined\n");
   for (degrees = 0; degrees <= 120; degrees += 30) {
      float c = cosf((float)degrees * 0.01745329f), s = sinf((float)degrees * 0.01745329f); /* about z, through the elbow */
      float palette[2][12] = { { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0 }, { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0 } };
      double percent[2], thickness[2];
      int k;
      palette[1][0] = c, palette[1][1] = -s, palette[1][3] = s * elbow;
      palette[1][4] = s, palette[1][5] = c, palette[1][7] = elbow - c * elbow;
      for (k = 0; k < 2; k++) {
         dn_pose pose = { 0 };
         dn_output out = { 0 };
         pose.palette = palette[0], pose.matrix = DN_3X4_ROWS;
         pose.strength = (float)k; /* 0: plain skinning, 1: all of the network's displacement */
         out.positions = posed[0];
         if (dn_deform(rig, &pose, &out, scratch, size, NULL, &err)) fprintf(stderr, "%s\n", err.info);
         percent[k] = 100 * volume(posed) / volume(rest);
         thickness[k] = 50 * across(posed[RINGS / 2 * SIDES], posed[RINGS / 2 * SIDES + SIDES / 2]) / (double)radius;
      }
      printf("%4d     %7.1f   %7.1f    %7.1f   %7.1f\n", degrees, percent[0], percent[1], thickness[0], thickness[1]);
   }
   dn_scratch_free(scratch, size, NULL);
   dn_rig_free(rig);
   dn_model_free(model);
   return 0;
}
