/*  skin.c - every text of linear blend skinning that this machine runs against the plain one

    shows   random shapes, one influence to nine, tails of 0 to 17 points, misaligned pointers, in place; nothing read or
            written outside; a point has the same bits wherever a range begins or ends; what is not finite stays with the
            points that list it; dn_lbs, whatever the count; a rig whose kernel is exchanged
    build   cc -O2 skin.c -o skin -lm */
#define DEFORMNET_IMPLEMENTATION
#define DEFORMNET_STATIC
#include "../deformnet.h"
#include "test.h"
#include <math.h>

#define GUARD 12345.5f /* around every output; must still be there afterwards */
enum { KERNELS = DN_KERNEL_COUNT };

typedef struct skin_case {
   size_t count, influences, joints, offset; /* offset: floats from a cache line to every array */
   float *block[5];
   float *rest, *weight, *palette, *wide, *out; /* (count,3) (count,I) (S,12) (S,16) (count,3) */
   uint32_t *joint_block, *joint;               /* (count,I) */
} skin_case;

static size_t pick(uint64_t *seed, size_t low, size_t high) { return low + test_random(seed) % (high - low + 1); }
/* each array ends where its block ends, so that a sanitizer sees a step too far; in front of out, and behind, a guard */
static skin_case skin_make(uint64_t *seed, size_t count, size_t influences, size_t joints, size_t offset)
{
   skin_case c;
   size_t i, k, floats[5];
   c.count = count, c.influences = influences, c.joints = joints, c.offset = offset;
   floats[0] = 3 * count, floats[1] = influences * count, floats[2] = 12 * joints, floats[3] = 16 * joints, floats[4] = 3 * count + 1;
   for (i = 0; i < 5; i++) c.block[i] = (float *)test_block((floats[i] + offset + 1) * sizeof(float));
   c.joint_block = (uint32_t *)test_block((influences * count + offset) * sizeof(uint32_t));
   c.rest = c.block[0] + offset + 1, c.weight = c.block[1] + offset + 1, c.palette = c.block[2] + offset + 1;
   c.wide = c.block[3] + offset + 1, c.out = c.block[4] + offset + 1, c.joint = c.joint_block + offset;
   for (i = 0; i < 3 * count; i++) c.rest[i] = test_uniform(seed, -2, 2);
   for (i = 0; i < 12 * joints; i++) c.palette[i] = test_uniform(seed, -1, 1);
   for (i = 0; i < 16 * joints; i++) c.wide[i] = i % 16 < 12 ? c.palette[i / 16 * 12 + i % 16] : NAN; /* must not matter */
   for (i = 0; i < count; i++) {
      float sum = 0;
      for (k = 0; k < influences; k++) {
         c.joint[i * influences + k] = (uint32_t)pick(seed, 0, joints - 1);
         c.weight[i * influences + k] = k > 0 && test_random(seed) % 4 == 0 ? 0 : test_uniform(seed, 0.01f, 1);
         sum += c.weight[i * influences + k];
      }
      for (k = 0; k < influences; k++) c.weight[i * influences + k] /= sum;
   }
   for (i = 0; i < 3 * count + 2; i++) c.block[4][offset + i] = GUARD;
   return c;
}
static void skin_free(skin_case *c)
{
   size_t i;
   for (i = 0; i < 5; i++) free(c->block[i]);
   free(c->joint_block);
}
/* half the last place of each number that is added up bounds a rounding; the first product, the sums over influences, the
   product with the point and three sums are rounded: 3 + influences times */
static int skin_close(const skin_case *c, size_t v, size_t axis, float found)
{
   double exact = 0, size = 0;
   size_t i, k;
   for (i = 0; i < c->influences; i++) {
      const float *row = c->palette + 12 * (size_t)c->joint[v * c->influences + i] + 4 * axis;
      double w = (double)c->weight[v * c->influences + i];
      for (k = 0; k < 4; k++) {
         double term = w * (double)row[k] * (k < 3 ? (double)c->rest[3 * v + k] : 1.0);
         exact += term;
         size += fabs(term);
      }
   }
   return fabs((double)found - exact) <= 6e-8 * (double)(5 + c->influences) * size;
}
static void skin_run(const skin_case *c, dn_kernel kernel, int wide, size_t begin, size_t end, float *out)
{
   dn__lbs_run(kernel, c->rest, c->joint, c->weight, c->influences, c->palette, wide ? c->wide : NULL, begin, end, out);
}
static size_t skin_bad(const skin_case *c)
{
   size_t v, k, bad = 0;
   for (v = 0; v < c->count; v++)
      for (k = 0; k < 3; k++) bad += !skin_close(c, v, k, c->out[3 * v + k]);
   return bad;
}

TEST(every_kernel_is_near_the_exact_sum)
{
   uint64_t seed = 1;
   size_t cases = 0, kernels = 0, count, influences, offset;
   int k, wide;
   for (k = 0; k < KERNELS; k++) {
      if (!dn_kernel_available((dn_kernel)k)) continue;
      kernels++;
      for (count = 0; count < 18; count++)
         for (influences = 1; influences < 10; influences++)
            for (offset = 0; offset < 4; offset++)
               for (wide = 0; wide < 2; wide++, cases++) {
                  skin_case c = skin_make(&seed, count, influences, pick(&seed, 1, 70), offset);
                  size_t bad;
                  skin_run(&c, (dn_kernel)k, wide, 0, count, c.out);
                  bad = skin_bad(&c);
                  CHECK_MSG(bad == 0, "kernel %d, %lu points of %lu influences, offset %lu: %lu numbers are off", k, (unsigned long)count,
                            (unsigned long)influences, (unsigned long)offset, (unsigned long)bad);
                  CHECK(c.out[-1] == GUARD && c.out[3 * count] == GUARD);
                  skin_free(&c);
               }
   }
   AT_LEAST(cases, 1296, "cases");
#if !defined(DN_NO_SIMD) && (defined(__x86_64__) || defined(__aarch64__))
   AT_LEAST(kernels, 2, "kernels");
#else
   AT_LEAST(kernels, 1, "kernels");
#endif
}
TEST(bits_do_not_depend_on_the_range)
{
   uint64_t seed = 2;
   size_t cases = 0, round;
   int k;
   for (k = 0; k < KERNELS; k++)
      for (round = 0; dn_kernel_available((dn_kernel)k) && round < 60; round++, cases++) {
         skin_case c = skin_make(&seed, pick(&seed, 1, 150), round % 2 ? 4 : pick(&seed, 1, 8), 20, round % 4);
         float *whole = (float *)test_block(3 * c.count * sizeof(float));
         size_t begin = 0, end;
         skin_run(&c, (dn_kernel)k, 0, 0, c.count, whole);
         for (; begin < c.count; begin = end) {
            end = begin + pick(&seed, 1, 9);
            if (end > c.count) end = c.count;
            skin_run(&c, (dn_kernel)k, 1, begin, end, c.out);
            CHECK(end == c.count || c.out[3 * end] == GUARD);
         }
         CHECK_MSG(memcmp(whole, c.out, 3 * c.count * sizeof(float)) == 0, "kernel %d, %lu points of %lu influences", k,
                   (unsigned long)c.count, (unsigned long)c.influences);
         skin_run(&c, (dn_kernel)k, 0, 0, 0, c.out);
         memcpy(c.out, c.rest, 3 * c.count * sizeof(float)); /* in place */
         dn__lbs_run((dn_kernel)k, c.out, c.joint, c.weight, c.influences, c.palette, NULL, 0, c.count, c.out);
         CHECK_MSG(memcmp(whole, c.out, 3 * c.count * sizeof(float)) == 0, "kernel %d in place", k);
         free(whole);
         skin_free(&c);
      }
   AT_LEAST(cases, 60, "cases");
}
TEST(what_is_not_finite_stays_with_its_points)
{
   uint64_t seed = 3;
   size_t cases = 0, v, i;
   int k;
   for (k = 0; k < KERNELS; k++) {
      skin_case c;
      if (!dn_kernel_available((dn_kernel)k)) continue;
      c = skin_make(&seed, 61, 4, 9, 1);
      for (i = 0; i < 12; i++) c.palette[12 * 5 + i] = c.wide[16 * 5 + i] = i % 2 ? NAN : INFINITY;
      skin_run(&c, (dn_kernel)k, k % 2, 0, c.count, c.out);
      for (v = 0; v < c.count; v++, cases++) {
         int listed = 0;
         for (i = 0; i < 4; i++) listed |= c.joint[4 * v + i] == 5;
         for (i = 0; i < 3; i++)
            CHECK_MSG(listed ? !test_finite(c.out[3 * v + i]) : skin_close(&c, v, i, c.out[3 * v + i]), "kernel %d, point %lu", k, (unsigned long)v);
      }
      skin_free(&c);
   }
   AT_LEAST(cases, 61, "points");
}
TEST(dn_lbs_whatever_the_count)
{
   static const size_t counts[] = { 0, 1, 7, 100, 1023, 1024, 1025, 5003 };
   uint64_t seed = 4;
   size_t i, cases = 0;
   for (i = 0; i < sizeof counts / sizeof *counts; i++, cases++) {
      skin_case c = skin_make(&seed, counts[i], 1 + i % 5, 65, i % 3);
      size_t bad;
      dn_lbs(c.rest, c.joint, c.weight, c.influences, c.count, c.palette, c.out);
      bad = skin_bad(&c);
      CHECK_MSG(bad == 0, "%lu points: %lu numbers are off", (unsigned long)c.count, (unsigned long)bad);
      CHECK(c.out[-1] == GUARD && c.out[3 * c.count] == GUARD);
      skin_free(&c);
   }
   AT_LEAST(cases, 8, "counts");
}
TEST(no_influences_give_the_origin)
{
   uint64_t seed = 5;
   skin_case c = skin_make(&seed, 20, 1, 3, 0);
   size_t i;
   int k;
   for (k = 0; k < KERNELS; k++) {
      if (!dn_kernel_available((dn_kernel)k)) continue;
      dn__lbs_run((dn_kernel)k, c.rest, c.joint, c.weight, 0, c.palette, NULL, 0, c.count, c.out);
      for (i = 0; i < 3 * c.count; i++) CHECK(c.out[i] == 0.0f);
   }
   skin_free(&c);
}
/* a rig that skins only, by each kernel: the frame hands over the same arrays */
TEST(a_rig_by_every_kernel)
{
   uint64_t seed = 6;
   skin_case c = skin_make(&seed, 1500, 4, 65, 0);
   dn_rig_desc d;
   dn_skin_set set;
   dn_error e;
   dn_rig *rig;
   size_t bytes, v, i, cases = 0;
   void *scratch;
   int k;
   memset(&d, 0, sizeof d);
   memset(&set, 0, sizeof set);
   set.influences = 4, set.joints = c.joint, set.joint_type = DN_U32, set.weights = c.weight, set.weight_type = DN_F32;
   d.mesh.vertices = c.count, d.mesh.positions = c.rest, d.mesh.skin_sets = 1, d.mesh.skin = &set;
   d.skeleton.joints = c.joints;
   rig = dn_rig_create(NULL, &d, NULL, NULL, &e);
   if (!CHECK(rig != NULL)) return;
   scratch = dn_scratch_create(rig, 1, NULL, &bytes, &e);
   for (k = 0; k < KERNELS; k++) {
      dn_pose pose;
      dn_output out;
      dn_rig_free(rig);
      d.kernel = (dn_kernel)k;
      rig = dn_rig_create(NULL, &d, NULL, NULL, &e);
      if (!dn_kernel_available((dn_kernel)k)) {
         CHECK(k == DN_KERNEL_AUTO ? rig != NULL : !rig && e.code == DN_UNSUPPORTED && strstr(e.info, "kernel") != NULL);
         continue;
      }
      if (!CHECK(rig != NULL)) break;
      memset(&pose, 0, sizeof pose);
      memset(&out, 0, sizeof out);
      pose.palette = c.palette;
      out.positions = c.out;
      CHECK(dn_deform(rig, &pose, &out, scratch, bytes, NULL, &e) == DN_OK);
      for (v = 0; v < c.count; v++, cases++) /* the rig keeps a vertex's positive weights in front */
         for (i = 0; i < 3; i++) CHECK_MSG(skin_close(&c, v, i, c.out[3 * v + i]), "kernel %d, vertex %lu", k, (unsigned long)v);
   }
   CHECK(c.out[-1] == GUARD && c.out[3 * c.count] == GUARD);
   AT_LEAST(cases, 1500, "vertices");
   dn_scratch_free(scratch, bytes, NULL);
   dn_rig_free(rig);
   skin_free(&c);
}

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(every_kernel_is_near_the_exact_sum);
   RUN(bits_do_not_depend_on_the_range);
   RUN(what_is_not_finite_stays_with_its_points);
   RUN(dn_lbs_whatever_the_count);
   RUN(no_influences_give_the_origin);
   RUN(a_rig_by_every_kernel);
   return TEST_END();
}
