/*  fuzz_model.c - a model file that somebody else wrote, or something else: load it, bind a tube (or a garment around it), deform
    with libFuzzer   clang -g -O1 -fsanitize=fuzzer,address,undefined -DFUZZ_LIBFUZZER fuzz_model.c -o fuzz_model -lm
                     ./fuzz_model corpus/
    without          cc -g -O1 -fsanitize=address,undefined fuzz_model.c -o fuzz_model -lm
                     ./fuzz_model [iterations [seed [FILE...]]]     the same inputs for the same numbers on any machine
                     ./fuzz_model 0 0 FILE...                       each file as it is: replays what a fuzzer found
    fails            when anything but an error or finite vertices comes out; sanitizers see the rest */
#define DEFORMNET_IMPLEMENTATION
#include "../deformnet.h"
#include "test.h"
#include "tiny.h"

enum { FUZZ_JOINTS = 64 };
static struct { size_t inputs, tables, loaded, ran, fallback; } seen;

#define REQUIRE(x) do { if (!(x)) { fprintf(stderr, "fuzz_model: input %lu: %s\n", (unsigned long)seen.inputs, #x); abort(); } } while (0)

#ifdef __cplusplus
extern "C"
#endif
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
   counting c;
   dn_allocator a = counting_allocator(&c, -1);
   dn_error e;
   dn_model *m;
   size_t bytes = 0, i;
   seen.inputs++;
   memset(&e, 0, sizeof e);
   if (dn_tensors_size(data, size, &bytes, &e) == DN_OK) {
      dn_tensors *t = NULL;
      void *memory = test_aligned(bytes);
      REQUIRE(bytes <= 4 * size + 4096);
      if (dn_tensors_open(data, size, memory, bytes, &t, &e) == DN_OK) {
         seen.tables++;
         for (i = 0; i < dn_tensors_count(t); i++) {
            const dn_tensor *x = dn_tensors_at(t, i);
            REQUIRE(dn_tensors_find(t, x->name) == x);
            REQUIRE(x->data >= data && x->data <= data + size);
            if (x->format != DN_ST_OTHER && x->count) { /* its last element lies in the file */
               float last;
               dn_tensor_floats(x, x->count - 1, 1, &last);
            }
         }
      } else REQUIRE(e.code != DN_OK && e.info[0]);
      test_aligned_free(memory);
   } else REQUIRE(e.code != DN_OK && e.info[0]);

   memset(&e, 0, sizeof e);
   m = dn_model_load(data, size, NULL, &a, &e);
   if (m) {
      static tube t; /* its skeleton: the three joints that skin it, or as many as the model names */
      static float inverse[FUZZ_JOINTS * 12], palette[FUZZ_JOINTS * 12];
      static int32_t parents[FUZZ_JOINTS];
      dn_model_info info;
      dn_output output;
      float out[TUBE_V * 3];
      dn_result r;
      seen.loaded++;
      dn_model_describe(m, &info);
      REQUIRE((info.row_width > 0 && info.feature_count > 0) || info.arch == DN_NEURALBLENDSHAPES);
      REQUIRE(info.unit > 0.0f && info.licence && info.trained_on && info.arch_name);
      tube_make(&t);
      if (info.joints >= TUBE_S && info.joints <= FUZZ_JOINTS) {
         for (i = 0; i < info.joints; i++) {
            memcpy(inverse + 12 * i, t.inverse_bind + 12 * (i % TUBE_S), 48);
            memcpy(palette + 12 * i, t.palette + 12 * (i % TUBE_S), 48);
            parents[i] = (int32_t)i - 1;
         }
         t.desc.skeleton.joints = info.joints;
         t.desc.skeleton.names = info.joint_names;
         t.desc.skeleton.parents = parents;
         t.desc.skeleton.inverse_bind = inverse;
         t.pose = palette;
      }
      if (info.arch == DN_GARFIT_COARSE || info.arch == DN_GARFITNET || info.arch == DN_CLOTHNET) r = tiny_wear(m, &t, out, NULL, &a, &e);
      else r = tiny_deform(m, &t, out, &output, &a, &e);
      if (r == DN_OK || r == DN_NOT_FINITE) {
         seen.ran++;
         seen.fallback += r == DN_NOT_FINITE;
         for (i = 0; i < TUBE_V * 3; i++) REQUIRE(test_finite(out[i]));
      } else REQUIRE(e.info[0]);
   } else REQUIRE(e.code != DN_OK && e.info[0]);
   dn_model_free(m);
   REQUIRE(c.live == 0 && c.wrong == 0);
   return 0;
}

#ifndef FUZZ_LIBFUZZER
enum { FUZZ_SEEDS = 64 };
static struct { unsigned char *data; size_t size; } corpus[FUZZ_SEEDS];
static size_t corpus_count;

static void add_seed(unsigned char *data, size_t size)
{
   if (corpus_count < FUZZ_SEEDS) corpus[corpus_count].data = data, corpus[corpus_count++].size = size;
   else free(data);
}
/* One change to the n bytes at p, which has room for cap; returns the new size. Blind changes seldom leave a header whole,
   so half of them know where numbers, names and weights stand. */
static size_t mutate(unsigned char *p, size_t n, size_t cap, uint64_t *r)
{
   static const char *const words[] = {"\"F16\"", "\"BF16\"", "\"I32\"", "\"U8\"", "4294967295", "18446744073709551615", "-1", "[]", "{}", "\\u0000", "\\ud800", "null",
      "rest", "dynamic", "mlp", "gat", "neuroskinning", "densegats", "multiresgnet", "geodesic", "distance", "position", "normal", "root", "__metadata__", "deformnet.joints",
      "1e9", "0", "65537", "clothnet", "garfitnet", "fit:1", "fit:2"};
   static const unsigned char floats[][4] = {{0, 0, 0xc0, 0x7f}, {0, 0, 0x80, 0x7f}, {0xff, 0xff, 0x7f, 0x7f}, {1, 0, 0, 0}, {0, 0, 0, 0x80}, {0, 0, 0x80, 0xff}, {0, 0, 0, 0x7f}};
   size_t header = n >= 8 ? dn__min(n, 8 + ((size_t)p[0] | (size_t)p[1] << 8)) : n, at, k, len;
   if (n == 0) {
      p[0] = (unsigned char)test_random(r);
      return 1;
   }
   at = test_random(r) % n;
   switch (test_random(r) % 10) {
   case 0: p[at] ^= (unsigned char)(1u << test_random(r) % 8); return n;
   case 1: p[at] = (unsigned char)test_random(r); return n;
   case 2: /* a digit of the header */
      for (k = 0; k < 64 && header > 9; k++) {
         at = 8 + test_random(r) % (header - 8);
         if (p[at] >= '0' && p[at] <= '9') {
            p[at] = (unsigned char)('0' + test_random(r) % 10);
            break;
         }
      }
      return n;
   case 3: /* a word over what is there, the length kept */
      k = test_random(r) % (sizeof words / sizeof *words);
      len = dn__min(strlen(words[k]), n - at);
      memcpy(p + at, words[k], len);
      return n;
   case 4: /* a piece taken out; the header's length follows when it lay there */
      len = 1 + test_random(r) % 40;
      len = dn__min(len, n - at);
      memmove(p + at, p + at + len, n - at - len);
      if (at >= 8 && at + len <= header && test_random(r) % 4) header -= 8 + len, p[0] = (unsigned char)header, p[1] = (unsigned char)(header >> 8);
      return n - len;
   case 5: /* a piece doubled */
      len = 1 + test_random(r) % 100;
      len = dn__min(dn__min(len, n - at), cap - n);
      memmove(p + at + len, p + at, n - at);
      if (at >= 8 && at + len <= header && test_random(r) % 4) header += len - 8, p[0] = (unsigned char)header, p[1] = (unsigned char)(header >> 8);
      return n + len;
   case 6: return at; /* cut */
   case 7:            /* a weight */
      if (n - header >= 4) memcpy(p + header + (test_random(r) % ((n - header) / 4)) * 4, floats[test_random(r) % (sizeof floats / 4)], 4);
      return n;
   case 8: /* two entries of the header change places in part */
      if (header > 100) {
         size_t b = 8 + test_random(r) % (header - 60);
         at = 8 + test_random(r) % (header - 60);
         for (k = 0; k < 40; k++) {
            unsigned char x = p[at + k];
            p[at + k] = p[b + k], p[b + k] = x;
         }
      }
      return n;
   default: /* spaces at the end of the header, the data moved: the file stays legal */
      len = dn__min(test_random(r) % 16, cap - n);
      if (n < 8) return n;
      memmove(p + header + len, p + header, n - header);
      memset(p + header, ' ', len);
      header += len - 8;
      p[0] = (unsigned char)header, p[1] = (unsigned char)(header >> 8);
      return n + len;
   }
}

int main(int argc, char **argv)
{
   unsigned long iterations = argc > 1 ? strtoul(argv[1], NULL, 10) : 20000, i;
   uint64_t random = argc > 2 ? strtoul(argv[2], NULL, 10) : 1;
   size_t size, k, cap;
   unsigned char *work;
   if (argc > 3)
      for (i = 3; i < (unsigned long)argc; i++) {
         unsigned char *file = test_file(argv[i], &size);
         add_seed(file, size);
      }
   else {
      unsigned char *file = tiny_mlp(&size);
      add_seed(file, size);
      file = tiny_multires("distance", "dynamic", &size), add_seed(file, size);
      file = tiny_multires("distance", "rest", &size), add_seed(file, size);
      file = tiny_multires("position", "dynamic", &size), add_seed(file, size);
      file = tiny_cloth("dynamic", &size), add_seed(file, size);
      file = tiny_cloth("rest", &size), add_seed(file, size);
      file = tiny_garfit("dynamic", &size), add_seed(file, size);
      file = tiny_garfit("rest", &size), add_seed(file, size);
   }
   for (k = 0, cap = 0; k < corpus_count; k++) {
      cap = dn__max(cap, corpus[k].size);
      LLVMFuzzerTestOneInput(corpus[k].data, corpus[k].size);
   }
   cap += 4096;
   work = (unsigned char *)test_block(cap);
   for (i = 0; i < iterations; i++) {
      size_t seed = test_random(&random) % corpus_count, changes = 1 + test_random(&random) % 4;
      unsigned char *exact;
      size = corpus[seed].size;
      memcpy(work, corpus[seed].data, size);
      for (k = 0; k < changes; k++) size = mutate(work, size, cap, &random);
      exact = test_copy(work, size); /* a block of exactly that size: a sanitizer guards its end */
      LLVMFuzzerTestOneInput(exact, size);
      free(exact);
   }
   printf("fuzz_model: %lu inputs, %lu tables opened, %lu models loaded, %lu ran, %lu of them with a fallback\n", (unsigned long)seen.inputs, (unsigned long)seen.tables,
          (unsigned long)seen.loaded, (unsigned long)seen.ran, (unsigned long)seen.fallback);
   free(work);
   for (k = 0; k < corpus_count; k++) free(corpus[k].data);
   if (iterations >= 1000 && argc <= 3 && (seen.loaded < iterations / 50 || seen.ran < iterations / 50 || seen.loaded > seen.inputs * 9 / 10)) {
      printf("FAIL fuzz_model: implausible inputs, too few or too many of them load\nfuzz_model: 0 passed, 1 failed\n");
      return 1;
   }
   printf("fuzz_model: %lu passed, 0 failed\n", (unsigned long)seen.inputs); /* the first that fails ends the program */
   return 0;
}
#endif
