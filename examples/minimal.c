/*  minimal.c - bend a tube, and let a network give back the volume that skinning loses
    shows     load a model, bind once, deform per frame, report errors
    not here  characters from files, threads, timing (refine.c); training (train/tiny.py made the model)
    build     cc -O2 minimal.c -o minimal -lm
    run       ./minimal [models/tiny.safetensors]     prints the tube's volume for five bends */
#define DEFORMNET_IMPLEMENTATION
#include "../deformnet.h"

enum { RINGS = 49, SIDES = 24, V = RINGS * SIDES + 2, T = 2 * RINGS * SIDES };
static float rest[V][3], weight[V][2], posed[V][3];
static uint8_t joint[V][2];
static uint16_t triangle[T][3];
static const float elbow = 0.3f; /* metres up; the tube is twice as long and 0.1 thick */

static void build_tube(void) /* along y, closed; joint 0 below the elbow, joint 1 above, a smooth step between */
{
   size_t v, t, r, s;
   for (v = 0; v < V; v++) {
      float turn = 6.2831853f * (float)(v % SIDES) / SIDES, radius = v < V - 2 ? 0.05f : 0.0f, u;
      rest[v][0] = radius * cosf(turn), rest[v][2] = radius * sinf(turn);
      rest[v][1] = v == V - 2 ? 0 : v == V - 1 ? 2 * elbow : 2 * elbow * (float)(v / SIDES) / (RINGS - 1);
      u = fminf(fmaxf((rest[v][1] - elbow) / elbow + 0.5f, 0), 1);
      weight[v][1] = u * u * (3 - 2 * u), weight[v][0] = 1 - weight[v][1];
      joint[v][1] = 1;
   }
   for (t = 0; t < T; t++) { /* two triangles a cell; at the ends one of them becomes the cap's */
      r = t / 2 / SIDES, s = t / 2 % SIDES;
      size_t a = r * SIDES + s, b = r * SIDES + (s + 1) % SIDES, last = r + 1 == RINGS;
      size_t corner[2][3] = { { a, last ? V - 1 : a + SIDES, b }, { b, a + SIDES, b + SIDES } };
      if (last) corner[1][0] = V - 2, corner[1][1] = s, corner[1][2] = (s + 1) % SIDES;
      for (v = 0; v < 3; v++) triangle[t][v] = (uint16_t)corner[t % 2][v];
   }
}
static double volume(float (*p)[3]) /* of the closed surface: a tetrahedron to the origin for each triangle */
{
   double sum = 0;
   for (size_t t = 0; t < T; t++) {
      const float *a = p[triangle[t][0]], *b = p[triangle[t][1]], *c = p[triangle[t][2]];
      sum += (double)(a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0]));
   }
   return sum / 6;
}

int main(int argc, char **argv)
{
   static const char *const names[2] = { "lower", "upper" };
   const float inverse_bind[24] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, /* upper: */ 1, 0, 0, 0, 0, 1, 0, -elbow, 0, 0, 1, 0 };
   const char *path = argc > 1 ? argv[1] : "models/tiny.safetensors";
   dn_error err = { 0 };
   dn_skin_set skin = { 2, joint, DN_U8, 0, weight, DN_F32, 0 };
   dn_rig_desc d = { 0 };
   build_tube();
   d.mesh.vertices = V, d.mesh.positions = rest[0];
   d.mesh.triangles = T, d.mesh.indices = triangle, d.mesh.index_type = DN_U16;
   d.mesh.skin_sets = 1, d.mesh.skin = &skin;
   d.skeleton.joints = 2, d.skeleton.names = names, d.skeleton.inverse_bind = inverse_bind; /* 3x4, rows */

   dn_model *model = dn_model_load_file(path, NULL, NULL, &err);
   dn_rig *rig = model ? dn_rig_create(model, &d, NULL, NULL, &err) : NULL;
   size_t size;
   void *scratch = rig ? dn_scratch_create(rig, 1, NULL, &size, &err) : NULL;
   if (!scratch) return fprintf(stderr, "%s: %s: %s (%s)\n", path, err.where, dn_result_text(err.code), err.info), 1;

   printf("bend   volume, %%: skinned   refined\n");
   for (int degrees = 0; degrees <= 120; degrees += 30) {
      float c = cosf((float)degrees * 0.01745329f), s = sinf((float)degrees * 0.01745329f); /* about z, through the elbow */
      float palette[24] = { 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, /* upper: */ c, -s, 0, s * elbow, s, c, 0, elbow - c * elbow, 0, 0, 1, 0 };
      double percent[2];
      for (int k = 0; k < 2; k++) {
         dn_pose pose = { 0 };
         dn_output out = { 0 };
         pose.palette = palette;
         pose.strength = (float)k; /* 0: plain skinning, 1: all of the network's displacement */
         out.positions = posed[0];
         if (dn_deform(rig, &pose, &out, scratch, size, NULL, &err)) fprintf(stderr, "%s\n", err.info);
         percent[k] = 100 * volume(posed) / volume(rest);
      }
      printf("%4d            %9.1f %9.1f\n", degrees, percent[0], percent[1]);
   }
   dn_scratch_free(scratch, size, NULL);
   dn_rig_free(rig);
   dn_model_free(model);
   return 0;
}
