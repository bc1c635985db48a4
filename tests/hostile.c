/*  hostile.c - what bad files, meshes, palettes, allocators and floating-point modes must not do
    One test for each known threat, t01 to t20: the input is refused with an error that names what is wrong, or it is
    legal and works. Run it under a sanitizer: half of each check is that nothing is read or written outside.
    build     cc -g -fsanitize=address,undefined hostile.c -o hostile -lm
    run       ./hostile [part of a test's name] */
#define DEFORMNET_IMPLEMENTATION
#include "../deformnet.h"
#include "test.h"
#include "tiny.h"
#include <fenv.h>
#include <locale.h>
#include <math.h>
#if defined(__SSE__) || defined(_M_X64)
   #include <xmmintrin.h>
#endif

/* --- one file against the reader and the loader: both must agree that it is bad, and say so */
static size_t cases;
static int refused(const unsigned char *file, size_t size, dn_result code, const char *word, const char *label)
{
   dn_error e;
   size_t bytes = 0;
   dn_tensors *t = NULL;
   dn_result r;
   void *memory = NULL;
   counting c;
   dn_allocator a = counting_allocator(&c, -1);
   dn_model *m;
   int ok = 1;
   cases++;
   memset(&e, 0, sizeof e);
   r = dn_tensors_size(file, size, &bytes, &e);
   if (r == DN_OK) {
      ok &= CHECK_MSG(bytes <= 4 * size + 4096, "%s: a table of %lu bytes for a file of %lu", label, (unsigned long)bytes, (unsigned long)size);
      memory = test_aligned(bytes);
      r = dn_tensors_open(file, size, memory, bytes, &t, &e);
   }
   ok &= CHECK_MSG(r == code, "%s: result %d (%s), expected %d", label, (int)r, r ? e.info : "", (int)code);
   if (r != DN_OK) {
      ok &= CHECK_MSG(t == NULL && e.code == r && e.where && e.info[0], "%s: an error must be told in full", label);
      ok &= CHECK_MSG(!word || strstr(e.info, word), "%s: \"%s\" does not say \"%s\"", label, e.info, word);
      ok &= CHECK_MSG(e.offset == SIZE_MAX || e.offset <= size, "%s: offset %lu in a file of %lu", label, (unsigned long)e.offset, (unsigned long)size);
      ok &= CHECK_MSG(dn_tensors_size(file, size, &bytes, NULL) == DN_OK || bytes == 0, "%s: without dn_error", label);
   }
   test_aligned_free(memory);
   memset(&e, 0, sizeof e);
   m = dn_model_load(file, size, NULL, &a, &e);
   if (code != DN_OK) {
      ok &= CHECK_MSG(m == NULL && e.code != DN_OK && e.info[0], "%s: the loader must refuse it too", label);
      ok &= CHECK_MSG(c.total <= 4 * size + 4096, "%s: %lu bytes allocated for %lu", label, (unsigned long)c.total, (unsigned long)size);
   }
   dn_model_free(m);
   ok &= CHECK_MSG(c.live == 0 && c.wrong == 0, "%s: %ld blocks live, %lu wrong calls", label, c.live, (unsigned long)c.wrong);
   return ok;
}
/* a header and so many bytes of data, in a block of the exact size */
static void header_is(const char *header, size_t data, dn_result code, const char *word)
{
   size_t size;
   unsigned char *zeros = (unsigned char *)test_block(data), *file;
   memset(zeros, 0, data);
   file = tiny_join(header, 0, zeros, data, &size);
   refused(file, size, code, word, header);
   free(file);
   free(zeros);
}
/* {"a":{...}} of a dtype, a shape and offsets, given as text */
static void tensor_is(const char *dtype, const char *shape, const char *offsets, size_t data, dn_result code, const char *word)
{
   char header[512];
   snprintf(header, sizeof header, "{\"a\":{\"dtype\":%s,\"shape\":%s,\"data_offsets\":%s}}", dtype, shape, offsets);
   header_is(header, data, code, word);
}
#define ENTRY(name, begin, end, count) \
   "\"" name "\":{\"dtype\":\"U8\",\"shape\":[" count "],\"data_offsets\":[" begin "," end "]}"

TEST(t01_header_length)
{
   static const uint64_t lengths[] = {0, 1, 3, 100, 64, 100000001u, 0x7fffffffu, 0x80000000u, 0xffffffffu, 0x100000000u,
      0x7fffffffffffffffu, 0x8000000000000000u, 0xfffffffffffffff7u, 0xfffffffffffffff8u, 0xffffffffffffffffu};
   size_t i, k, size, bytes;
   cases = 0;
   for (i = 0; i < sizeof lengths / sizeof *lengths; i++) {
      unsigned char *file = tiny_join("{}", 8, NULL, 0, &size);
      char label[64];
      dn_error e;
      dn_result r;
      for (k = 0; k < 8; k++) file[k] = (unsigned char)(lengths[i] >> (8 * k));
      snprintf(label, sizeof label, "length %lx%08lx", (unsigned long)(lengths[i] >> 32), (unsigned long)(lengths[i] & 0xffffffffu));
      r = dn_tensors_size(file, size, &bytes, &e); /* 3: the header ends inside its own spaces, the rest is stray data */
      refused(file, size, lengths[i] == 3 ? DN_BAD_LAYOUT : lengths[i] < 2 || lengths[i] > 100000000u ? DN_BAD_HEADER : DN_TRUNCATED,
              lengths[i] == 3 ? "bytes of data" : "header length", label);
      CHECK(lengths[i] == 3 ? r == DN_OK : r != DN_OK && bytes == 0);
      free(file);
   }
   header_is("{}", 0, DN_OK, NULL);
   AT_LEAST(cases, 16, "lengths");
}

TEST(t02_not_a_header)
{
   static const struct { const char *header, *word; } bad[] = {{"  ", "first byte"}, {" {}", "first byte"}, {"[]", "first byte"}, {"\"\"", "first byte"}, {"nu", "first byte"},
      {" " "{" ENTRY("a", "0", "0", "0") "}", "first byte"}, {"{]", "in quotes"}, {"{}x", "only white space"}, {"{} {}", "only white space"}, {"{}\x01", "0x01"}, {"{,}", "in quotes"},
      {"{\"a\"}", "':'"}, {"{\"a\":}", "'{'"}, {"{\"a\":1}", "'{'"}, {"{\"__metadata__\":{}", "end of the header"}, {"{\"a:1}", "closing quote"}, {"{a:1}", "in quotes"}, {"{'a':1}", "in quotes"},
      {"{" ENTRY("\x80", "0", "0", "0") "}", "UTF-8"}, {"{" ENTRY("\xc0\xaf", "0", "0", "0") "}", "UTF-8"}, {"{" ENTRY("\xc1\xbf", "0", "0", "0") "}", "UTF-8"},
      {"{" ENTRY("\xe0\x9f\xbf", "0", "0", "0") "}", "UTF-8"}, {"{" ENTRY("\xed\xa0\x80", "0", "0", "0") "}", "UTF-8"}, {"{" ENTRY("\xf0\x8f\xbf\xbf", "0", "0", "0") "}", "UTF-8"},
      {"{" ENTRY("\xf4\x90\x80\x80", "0", "0", "0") "}", "UTF-8"}, {"{" ENTRY("\xf5\x80\x80\x80", "0", "0", "0") "}", "UTF-8"}, {"{" ENTRY("\xf8\x88\x80\x80\x80", "0", "0", "0") "}", "UTF-8"},
      {"{" ENTRY("\xc3", "0", "0", "0") "}", "UTF-8"}, {"{" ENTRY("\xe2\x82", "0", "0", "0") "}", "UTF-8"}, {"{" ENTRY("\xf0\x9f\x98", "0", "0", "0") "}", "UTF-8"},
      {"{\"\xc3", "UTF-8"}, {"{\"\xe2\x82", "UTF-8"}, {"{\"\xf0\x9f\x98", "UTF-8"}, {"{\"__metadata__\":{\"k\":\"\xff\"}}", "UTF-8"}, {"{\"a\\", "backslash"}, {"{\"a\\u00", "hex"},
      {"{" ENTRY("a\\u0000b", "0", "0", "0") "}", "NUL"}, {"{" ENTRY("a\\x41", "0", "0", "0") "}", "backslash"}, {"{" ENTRY("a\\u00g0", "0", "0", "0") "}", "hex"},
      {"{" ENTRY("\\ud800", "0", "0", "0") "}", "surrogates"}, {"{" ENTRY("\\udc00", "0", "0", "0") "}", "surrogates"}, {"{" ENTRY("\\ud800\\u0041", "0", "0", "0") "}", "surrogates"},
      {"{" ENTRY("\\ud800\\ue000", "0", "0", "0") "}", "surrogates"}, {"{" ENTRY("\\u12", "0", "0", "0") "}", "hex"}, {"{" ENTRY("a\nb", "0", "0", "0") "}", "control character"},
      {"{" ENTRY("a\tb", "0", "0", "0") "}", "control character"}, {"{" ENTRY("a", "0", "0", "0") ",}", "in quotes"}, {"{" ENTRY("a", "0", "0", "0") " " ENTRY("b", "0", "0", "0") "}", "'}'"},
      {"{" ENTRY("a", "0", "0", "0") "} junk", "only white space"}, {"{" ENTRY("a", "0", "0", "0") "}}", "only white space"}, {"{\"a\":{}}", "\"dtype\""}, {"{/**/}", "in quotes"},
      {"{\"a\":{\"dtype\":\"U8\"}}", "'shape' is missing"}, {"{\"a\":{\"dtype\":\"U8\",\"shape\":[0]}}", "'data_offsets' is missing"},
      {"{\"a\":{\"data_offsets\":[0,0],\"shape\":[0]}}", "'dtype' is missing"}};
   static const char *const good[] = {"{}", "{ }", "{}  \n\t\r ", "{" ENTRY("", "0", "0", "0") "}", "{ \"\\u00e9\" : { \"shape\" : [ ] , \"data_offsets\" : [ 0 , 1 ] ,"
      " \"dtype\" : \"BOOL\" } }", "{\"__metadata__\":{}}", "{\"__metadata__\":{\"k\":\"\\n\\ud83d\\ude00\"}}", "{" ENTRY("\xf0\x9f\x98\x80", "0", "0", "0") "}"};
   static const char nul_header[] = "{\"a\0b\":1}";
   unsigned char bytes[8] = {2, 0, 0, 0, 0, 0, 0, 0}, *file;
   size_t n, i, size;
   cases = 0;
   for (n = 0; n < 8; n++) {
      file = test_copy(bytes, n);
      refused(file, n, DN_TRUNCATED, "8", "a file of less than 8 bytes");
      free(file);
   }
   for (i = 0; i < sizeof bad / sizeof *bad; i++) header_is(bad[i].header, 0, DN_BAD_HEADER, bad[i].word);
   for (i = 0; i < sizeof good / sizeof *good; i++) header_is(good[i], i == 4 ? 1 : 0, DN_OK, NULL);
   file = tiny_join("{\"a#b\":1}", 0, NULL, 0, &size); /* a raw NUL, which tiny_join's strlen cannot see */
   memcpy(file + 8, nul_header, sizeof nul_header - 1);
   refused(file, size, DN_BAD_HEADER, "control character", "NUL in a name");
   free(file);
   AT_LEAST(cases, 70, "headers");
}

TEST(t03_duplicate_keys)
{
   cases = 0;
   header_is("{" ENTRY("left", "0", "1", "1") "," ENTRY("left", "1", "2", "1") "}", 2, DN_BAD_HEADER, "left");
   header_is("{" ENTRY("left", "0", "1", "1") "," ENTRY("le\\u0066t", "1", "2", "1") "}", 2, DN_BAD_HEADER, "left");
   header_is("{" ENTRY("\\/", "0", "1", "1") "," ENTRY("/", "1", "2", "1") "}", 2, DN_BAD_HEADER, "'/'");
   header_is("{" ENTRY("\\ud83d\\ude00", "0", "1", "1") "," ENTRY("\xf0\x9f\x98\x80", "1", "2", "1") "}", 2, DN_BAD_HEADER, "twice");
   header_is("{\"__metadata__\":{\"key\":\"1\",\"k\\u0065y\":\"2\"}}", 0, DN_BAD_HEADER, "key");
   header_is("{\"__metadata__\":{},\"__metadata__\":{}}", 0, DN_BAD_HEADER, "__metadata__");
   header_is("{\"__metadata__\":{},\"\\u005f_metadata__\":{}}", 0, DN_BAD_HEADER, "__metadata__");
   header_is("{\"a\":{\"dtype\":\"U8\",\"dtype\":\"U8\",\"shape\":[0],\"data_offsets\":[0,0]}}", 0, DN_BAD_HEADER, "dtype");
   header_is("{\"a\":{\"dtype\":\"U8\",\"shape\":[0],\"sh\\u0061pe\":[0],\"data_offsets\":[0,0]}}", 0, DN_BAD_HEADER, "shape");
   header_is("{\"a\":{\"dtype\":\"U8\",\"shape\":[0],\"data_offsets\":[0,0],\"data_offsets\":[0,0]}}", 0, DN_BAD_HEADER, "data_offsets");
   header_is("{\"a\":{\"dtype\":\"U8\",\"shape\":[0],\"data_offsets\":[0,0],\"more\":0}}", 0, DN_BAD_HEADER, "another key");
   header_is("{\"__metadata__\":{\"a\":\"\"}," ENTRY("a", "0", "1", "1") "}", 1, DN_OK, NULL); /* two name spaces */
   header_is("{" ENTRY("A", "0", "1", "1") "," ENTRY("a", "1", "2", "1") "}", 2, DN_OK, NULL);
   AT_LEAST(cases, 13, "headers");
}

TEST(t04_data_layout)
{
   cases = 0;
   header_is("{" ENTRY("a", "0", "4", "4") "," ENTRY("b", "2", "6", "4") "}", 6, DN_BAD_LAYOUT, "'b'");
   header_is("{" ENTRY("a", "0", "4", "4") "," ENTRY("b", "0", "4", "4") "}", 4, DN_BAD_LAYOUT, "begins at 0, expected 4");
   header_is("{" ENTRY("a", "0", "8", "8") "," ENTRY("b", "2", "4", "2") "}", 8, DN_BAD_LAYOUT, "'b'");
   header_is("{" ENTRY("a", "0", "2", "2") "," ENTRY("b", "3", "5", "2") "}", 5, DN_BAD_LAYOUT, "begins at 3, expected 2");
   header_is("{" ENTRY("a", "1", "2", "1") "}", 2, DN_BAD_LAYOUT, "first byte");
   header_is("{" ENTRY("a", "0", "2", "2") "}", 3, DN_BAD_LAYOUT, "3 bytes of data");
   header_is("{}", 1, DN_BAD_LAYOUT, "1 bytes of data");
   header_is("{" ENTRY("a", "0", "3", "3") "}", 2, DN_BAD_LAYOUT, "at most 2");
   header_is("{" ENTRY("a", "0", "2", "2") "," ENTRY("b", "3", "3", "0") "," ENTRY("c", "2", "4", "2") "}", 4, DN_BAD_LAYOUT, "'b'");
   header_is("{" ENTRY("c", "3", "6", "3") "," ENTRY("a", "0", "1", "1") "," ENTRY("e", "6", "6", "0") "," ENTRY("b", "1", "3", "2") "}", 6, DN_OK, NULL);
   header_is("{" ENTRY("a", "0", "0", "0") "," ENTRY("b", "0", "1", "1") "," ENTRY("c", "0", "0", "0") "," ENTRY("d", "1", "1", "0") "}", 1, DN_OK, NULL);
   { /* any order of any number of ranges is found; one range moved by one byte is found out */
      uint64_t seed = 4;
      size_t round, i, n, size, data, found = 0;
      for (round = 0; round < 200; round++) {
         static char header[65536];
         size_t begin[128], width[128], order[128], used = 0, spoil;
         n = 1 + test_random(&seed) % 128;
         for (i = 0, data = 0; i < n; i++) begin[i] = data, data += width[i] = test_random(&seed) % 4, order[i] = i;
         for (i = n; i-- > 1;) {
            size_t k = test_random(&seed) % (i + 1), x = order[i];
            order[i] = order[k], order[k] = x;
         }
         spoil = round % 2 ? test_random(&seed) % n : n;
         if (spoil < n && (width[spoil] == 0 || begin[spoil] == 0)) spoil = n;
         for (i = 0; i < n; i++) {
            size_t k = order[i], at = begin[k] - (k == spoil);
            used += (size_t)snprintf(header + used, sizeof header - used, "%c\"t%lu\":{\"dtype\":\"U8\",\"shape\":[%lu],\"data_offsets\":[%lu,%lu]}",
                                     i ? ',' : '{', (unsigned long)k, (unsigned long)width[k], (unsigned long)at, (unsigned long)(at + width[k]));
         }
         memcpy(header + used, "}", 2);
         {
            static const unsigned char zeros[512] = {0};
            unsigned char *file = tiny_join(header, 0, zeros, data, &size);
            refused(file, size, spoil < n ? DN_BAD_LAYOUT : DN_OK, NULL, "shuffled ranges");
            found += spoil < n;
            free(file);
         }
      }
      AT_LEAST(found, 50, "spoilt orders");
   }
   AT_LEAST(cases, 200, "layouts");
}

TEST(t05_number_syntax)
{
   static const char *const bad[] = {"[3,1]", "[-1,1]", "[0,-1]", "[-0,1]", "[00,1]", "[0,01]", "[0,1e9]", "[0,1E0]", "[0,1.0]", "[0,1.]",
      "[0,.1]", "[+0,1]", "[0,99999999999999999999]", "[0,18446744073709551615]", "[0,18446744073709551616]", "[18446744073709551615,0]",
      "[18446744073709551608,18446744073709551609]", "[0,340282366920938463463374607431768211457]", "[0x0,1]", "[0,0x1]", "[0]", "[]", "[0,1,2]", "[0,1,]",
      "[,1]", "[0 1]", "0,1", "{\"0\":1}", "[\"0\",1]", "[0,\"1\"]", "[0,null]", "[0,true]", "[0,NaN]", "[0,Infinity]", "[[0,1]]", "null", "\"\"", "[0,2]", "[1,1]"};
   static const char *const sides[] = {"[-1]", "[01]", "[1.0]", "[1e0]", "[1,]", "[,1]", "[[1]]", "[\"1\"]", "[null]", "1", "null", "{}", "[1 1]"};
   size_t i;
   cases = 0;
   for (i = 0; i < sizeof bad / sizeof *bad; i++) {
      char header[256];
      size_t size;
      unsigned char *file;
      dn_error e;
      size_t bytes;
      snprintf(header, sizeof header, "{\"tt\":{\"dtype\":\"U8\",\"shape\":[1],\"data_offsets\":%s}}", bad[i]);
      file = tiny_join(header, 0, "x", 1, &size);
      cases++;
      CHECK_MSG(dn_tensors_size(file, size, &bytes, &e) != DN_OK, "%s was accepted", header);
      CHECK_MSG(strstr(e.info, "tensor 'tt'") != NULL && (e.code == DN_BAD_HEADER || e.code == DN_BAD_LAYOUT), "%s: %s", header, e.info);
      free(file);
   }
   for (i = 0; i < sizeof sides / sizeof *sides; i++) tensor_is("\"U8\"", sides[i], "[0,1]", 1, DN_BAD_HEADER, "tensor 'a'");
   tensor_is("\"U8\"", "[1]", "[0,1]", 1, DN_OK, NULL);
   AT_LEAST(cases, 52, "numbers");
}

TEST(t06_shape_products)
{
   cases = 0;
   tensor_is("\"F32\"", "[4294967296,4294967296]", "[0,0]", 0, sizeof(size_t) > 4 ? DN_BAD_SHAPE : DN_BAD_HEADER, "tensor 'a'"); /* 2^64: wraps to 0 */
   tensor_is("\"F32\"", "[65536,65536]", "[0,0]", 0, sizeof(size_t) > 4 ? DN_BAD_LAYOUT : DN_BAD_SHAPE, "tensor 'a'");             /* 2^32: to 0 in 32 bits */
   tensor_is("\"F32\"", "[65536,16384]", "[0,0]", 0, sizeof(size_t) > 4 ? DN_BAD_LAYOUT : DN_BAD_SHAPE, "tensor 'a'");             /* 2^30 x 4 */
   tensor_is("\"F32\"", "[4294967297,4294967297]", "[0,4]", 4, sizeof(size_t) > 4 ? DN_BAD_SHAPE : DN_BAD_HEADER, "tensor 'a'");   /* wraps to small */
   tensor_is("\"F32\"", "[1073741825]", "[0,4]", 4, sizeof(size_t) > 4 ? DN_BAD_LAYOUT : DN_BAD_SHAPE, "tensor 'a'");              /* x 4 wraps to 4 */
   tensor_is("\"F64\"", "[2305843009213693953]", "[0,8]", 8, sizeof(size_t) > 4 ? DN_BAD_SHAPE : DN_BAD_HEADER, "tensor 'a'");     /* x 8 wraps to 8 */
   tensor_is("\"U8\"", "[9223372036854775808]", "[0,0]", 0, sizeof(size_t) > 4 ? DN_BAD_SHAPE : DN_BAD_HEADER, "tensor 'a'");      /* negative as int64 */
   tensor_is("\"U8\"", "[4294967295,4294967297]", "[0,0]", 0, sizeof(size_t) > 4 ? DN_BAD_SHAPE : DN_BAD_HEADER, "tensor 'a'");
   tensor_is("\"F32\"", "[65536,65536,65536,65536,0]", "[0,0]", 0, DN_BAD_SHAPE, "product"); /* the zero hides nothing */
   tensor_is("\"F32\"", "[0,65536,65536,65536,65536]", "[0,0]", 0, DN_BAD_SHAPE, "product");
   tensor_is("\"F32\"", "[-1]", "[0,4]", 4, DN_BAD_HEADER, "whole number");
   tensor_is("\"F32\"", "[]", "[0,4]", 4, DN_OK, NULL);
   tensor_is("\"F32\"", "[]", "[0,0]", 0, DN_BAD_LAYOUT, "expected 4");
   tensor_is("\"F32\"", "[0]", "[0,0]", 0, DN_OK, NULL);
   tensor_is("\"F32\"", "[3,0,5]", "[0,0]", 0, DN_OK, NULL);
   tensor_is("\"F32\"", "[0]", "[0,4]", 4, DN_BAD_LAYOUT, "expected 0");
   tensor_is("\"F32\"", "[1,1,1,1,1,1,1,1]", "[0,4]", 4, DN_OK, NULL);
   tensor_is("\"F32\"", "[1,1,1,1,1,1,1,1,1]", "[0,4]", 4, DN_BAD_SHAPE, "8 sides");
   { /* what the view says of them */
      static const char header[] = "{\"r0\":{\"dtype\":\"F32\",\"shape\":[],\"data_offsets\":[0,4]},\"r5\":{\"dtype\":\"F32\",\"shape\":[1,2,1,2,1],\"data_offsets\":[4,20]},"
         "\"z\":{\"dtype\":\"F32\",\"shape\":[7,0],\"data_offsets\":[20,20]}}";
      static const unsigned char data[20] = {0, 0, 0x80, 0x3f};
      size_t size, bytes;
      unsigned char *file = tiny_join(header, 0, data, 20, &size);
      dn_tensors *t = NULL;
      const dn_tensor *x;
      void *memory;
      float f = 0;
      CHECK(dn_tensors_size(file, size, &bytes, NULL) == DN_OK);
      memory = test_aligned(bytes);
      CHECK(dn_tensors_open(file, size, memory, bytes - 1, &t, NULL) == DN_TOO_SMALL && !t);
      CHECK(dn_tensors_open(file, size, memory, bytes, &t, NULL) == DN_OK && dn_tensors_count(t) == 3);
      x = dn_tensors_find(t, "r0");
      if (CHECK(x && x->rank == 0 && x->count == 1 && x->format == DN_ST_F32)) dn_tensor_floats(x, 0, 1, &f);
      CHECK(f == 1.0f);
      x = dn_tensors_find(t, "r5");
      CHECK(x && x->rank == 5 && x->count == 4 && x->format == DN_ST_OTHER && x->shape[3] == 2);
      x = dn_tensors_find(t, "z");
      CHECK(x && x->rank == 2 && x->count == 0 && x->shape[0] == 7 && x->shape[1] == 0);
      CHECK(!dn_tensors_find(t, "r") && !dn_tensors_find(t, "") && !dn_tensors_meta(t, "r0"));
      test_aligned_free(memory);
      free(file);
   }
   AT_LEAST(cases, 18, "shapes");
}

TEST(t07_type_times_shape_is_range)
{
   static const struct { const char *name; size_t width; } types[] = {{"F32", 4}, {"F16", 2}, {"BF16", 2}, {"I32", 4}, {"F64", 8}, {"I64", 8}, {"U64", 8},
      {"C64", 8}, {"U32", 4}, {"I16", 2}, {"U16", 2}, {"I8", 1}, {"U8", 1}, {"BOOL", 1}, {"F8_E5M2", 1}, {"F8_E4M3", 1}, {"F8_E8M0", 1}};
   size_t i, n;
   cases = 0;
   for (i = 0; i < sizeof types / sizeof *types; i++)
      for (n = 0; n < 50; n++) {
         char dtype[32], offsets[32];
         snprintf(dtype, sizeof dtype, "\"%s\"", types[i].name);
         snprintf(offsets, sizeof offsets, "[0,%lu]", (unsigned long)n);
         tensor_is(dtype, "[2,3]", offsets, n, n == 6 * types[i].width ? DN_OK : DN_BAD_LAYOUT, types[i].name);
      }
   AT_LEAST(cases, 850, "ranges");
}

TEST(t08_element_types)
{
   static const char *const bad[] = {"\"f32\"", "\"F32 \"", "\" F32\"", "\"F33\"", "\"\"", "\"float32\"", "\"F4\"", "\"F6_E2M3\"", "\"F6_E3M2\"", "\"I4\"",
      "\"U1\"", "\"Q4_0\"", "\"BF32\"", "\"bool\"", "\"F8\"", "\"F32\\u00e9\"", "\"F32F32F32F32F32F32F32F32F32F32\""};
   static const char *const wrong[] = {"32", "null", "[\"F32\"]", "{}", "F32", "true"};
   size_t i;
   cases = 0;
   for (i = 0; i < sizeof bad / sizeof *bad; i++) tensor_is(bad[i], "[1]", "[0,4]", 4, DN_BAD_TYPE, "dtype");
   for (i = 0; i < sizeof wrong / sizeof *wrong; i++) tensor_is(wrong[i], "[1]", "[0,4]", 4, DN_BAD_HEADER, "dtype");
   tensor_is("\"F\\u00332\"", "[1]", "[0,4]", 4, DN_OK, NULL); /* an escape is the character itself */
   AT_LEAST(cases, 24, "types");
}

TEST(t09_rounding_and_products_wrap)
{
   static const size_t edge[] = {0, 1, 2, 3, 63, 64, 65, 255, 65535, 65536, SIZE_MAX / 64, SIZE_MAX / 16, SIZE_MAX / 4, SIZE_MAX / 2, SIZE_MAX / 2 + 1,
      SIZE_MAX - 128, SIZE_MAX - 64, SIZE_MAX - 63, SIZE_MAX - 62, SIZE_MAX - 1, SIZE_MAX};
   size_t i, k, n = sizeof edge / sizeof *edge, looked = 0;
   for (i = 0; i < n; i++) {
      CHECK(dn__round(edge[i], 64) >= edge[i] && (dn__round(edge[i], 64) % 64 == 0 || dn__round(edge[i], 64) == SIZE_MAX));
      for (k = 0; k < n; k++, looked++) {
         size_t a = edge[i], b = edge[k], p = dn__mul(a, b), s = dn__add(a, b);
         dn__arena arena = dn__arena_of(NULL, 0);
         CHECK(b == 0 ? p == 0 : p == SIZE_MAX ? a >= SIZE_MAX / b : p / b == a);
         CHECK(s >= a && s >= b);
         CHECK(dn__take(&arena, a, b) == NULL && dn__gauge(&arena) >= p); /* measuring saturates too */
         CHECK(dn__take(&arena, SIZE_MAX, 1) == NULL && dn__gauge(&arena) == SIZE_MAX && dn__take(&arena, 64, 1) == NULL && dn__gauge(&arena) == SIZE_MAX);
         if (a && b) { /* sizes from a file: either 0, or enough for what they stand for */
            size_t l = dn_linear_size(a, b), g = dn_gat_size(a, b, 1, 0), h = dn_gat_size(1, a, b, b), q = dn_pool_size(a, b);
            CHECK(l == 0 || l == SIZE_MAX || (p < SIZE_MAX / 4 && l >= 4 * p));
            CHECK(g == 0 || g == SIZE_MAX || (p < SIZE_MAX / 4 && g >= 4 * p));
            CHECK(h == 0 || h == SIZE_MAX || (p < SIZE_MAX / 4 && h >= 4 * p));
            CHECK(q == 0 || q == SIZE_MAX || (a < SIZE_MAX / 8 && q >= 8 * a));
         }
      }
   }
   { /* a full arena stays full, and gives nothing past its end */
      void *block = test_aligned(256);
      dn__arena arena = dn__arena_of(block, 256);
      CHECK(dn__take(&arena, SIZE_MAX - 3, 1) == NULL && dn__take(&arena, 1, 1) == NULL);
      arena = dn__arena_of(block, 256);
      CHECK(dn__take(&arena, 192, 1) == block && dn__take(&arena, 65, 1) == NULL && dn__take(&arena, 1, 1) == NULL);
      test_aligned_free(block);
   }
   AT_LEAST(looked, 400, "pairs");
}

/* --- files so large that a slow reader would be noticed; the text is written once, in place */
static unsigned char *big_begin(size_t cap) { return (unsigned char *)test_block(cap); }
static void big_end(unsigned char *file, size_t end)
{
   size_t k;
   for (k = 0; k < 8; k++) file[k] = (unsigned char)((uint64_t)(end - 8) >> (8 * k));
}
TEST(t10_depth_and_time)
{
   static const char *const open[] = {"[", "{\"a\":", "{\"a\":[", "{\"__metadata__\":", "{\"a\":{\"shape\":["};
   size_t cap = 100000008u, i, k, n, end, size, bytes, keys = 1000000;
   unsigned char *file = big_begin(cap);
   dn_error e;
   clock_t start = clock();
   dn_tensors *t = NULL;
   void *memory;
   cases = 0;
   for (i = 0; i < sizeof open / sizeof *open; i++) { /* a million levels */
      n = strlen(open[i]);
      file[8] = '{';
      memcpy(file + 9, "\"x\":", 4);
      for (k = 0, end = 13; k < 1000000; k++, end += n) memcpy(file + end, open[i], n);
      big_end(file, end);
      refused(file, end, DN_BAD_HEADER, "expected", "a million brackets");
   }
   memset(file + 8, ' ', cap - 8); /* as many spaces as a header may hold, after and inside */
   file[8] = '{', file[9] = '}';
   big_end(file, cap);
   refused(file, cap, DN_OK, NULL, "100 MB of spaces after the object");
   file[9] = ' ', file[cap - 1] = '}';
   refused(file, cap, DN_OK, NULL, "100 MB of spaces inside the object");
   file[cap - 1] = ' ';
   refused(file, cap, DN_BAD_HEADER, "the end of the header", "100 MB of spaces and no end");
   memset(file + 8, '"', 1); /* and of other things */
   memset(file + 9, '\\', cap - 9);
   refused(file, cap, DN_BAD_HEADER, "'{'", "100 MB of backslashes");
   file[8] = '{', file[9] = '"';
   memset(file + 10, 'n', cap - 10);
   refused(file, cap, DN_BAD_HEADER, "closing quote", "a name of 100 MB");
   memset(file + 8, '9', cap - 8);
   memcpy(file + 8, "{\"a\":{\"dtype\":\"U8\",\"shape\":[", strlen("{\"a\":{\"dtype\":\"U8\",\"shape\":["));
   refused(file, cap, DN_BAD_HEADER, "fits", "a number of 100 million digits");

   for (i = 0; i < 2; i++) { /* a million keys: as tensors, as metadata */
      end = 8;
      end += (size_t)snprintf((char *)file + end, 64, i ? "{\"__metadata__\":{" : "{");
      for (k = 0; k < keys; k++)
         end += (size_t)snprintf((char *)file + end, 128, i ? "%s\"key%lu\":\"\"" : "%s\"key%lu\":{\"dtype\":\"U8\",\"shape\":[0],\"data_offsets\":[0,0]}",
                                 k ? "," : "", (unsigned long)k);
      end += (size_t)snprintf((char *)file + end, 8, i ? "}}" : "}");
      big_end(file, end);
      refused(file, end, DN_OK, NULL, "a million keys");
      if (!CHECK(dn_tensors_size(file, end, &bytes, NULL) == DN_OK)) continue;
      CHECK_MSG(bytes <= 4 * end, "%lu bytes of table for %lu of header", (unsigned long)bytes, (unsigned long)end);
      memory = test_aligned(bytes);
      if (CHECK(dn_tensors_open(file, end, memory, bytes, &t, NULL) == DN_OK)) {
         CHECK(dn_tensors_count(t) == (i ? 0 : keys));
         for (k = 0, n = 0; k < keys; k++) {
            char name[32];
            snprintf(name, sizeof name, "key%lu", (unsigned long)k);
            if (i) n += dn_tensors_meta(t, name) != NULL;
            else n += dn_tensors_find(t, name) == dn_tensors_at(t, k);
         }
         CHECK_MSG(n == keys, "found %lu of a million", (unsigned long)n);
         CHECK(!dn_tensors_find(t, "key") && !dn_tensors_meta(t, "key1000000"));
      }
      test_aligned_free(memory);
   }
   { /* names made to fall into one slot of the table: refused, not searched for minutes */
      size_t slots = dn__names_slots(2000), found = 0;
      end = 9;
      file[8] = '{';
      for (k = 0; found < 2000; k++) {
         char name[32];
         snprintf(name, sizeof name, "n%lu", (unsigned long)k);
         if ((dn__hash(name) & (slots - 1)) != 5) continue;
         end += (size_t)snprintf((char *)file + end, 128, "%s\"%s\":{\"dtype\":\"U8\",\"shape\":[0],\"data_offsets\":[0,0]}", found++ ? "," : "", name);
      }
      file[end++] = '}';
      big_end(file, end);
      refused(file, end, DN_UNSUPPORTED, "collide", "2000 names in one slot");
   }
   size = 0;
   memset(&e, 0, sizeof e);
   CHECK(dn_tensors_size(file, size, &bytes, &e) == DN_TRUNCATED);
   free(file);
   CHECK_MSG((double)(clock() - start) / CLOCKS_PER_SEC < 120.0, "took %.0f s of processor time", (double)(clock() - start) / CLOCKS_PER_SEC);
   AT_LEAST(cases, 14, "large headers");
}

TEST(t11_wrong_kinds_of_value)
{
   static const char *const values[] = {"1", "-1", "1.5", "null", "true", "[]", "{}", "[\"a\"]", "{\"a\":\"b\"}", "a", "'a'", "", "\"a\" \"b\""};
   static const char *const whole[] = {"null", "[]", "\"\"", "1", "{\"a\"}", "{1:\"a\"}", "{\"a\":\"b\",}", "{,}"};
   char header[256];
   size_t i;
   cases = 0;
   for (i = 0; i < sizeof values / sizeof *values; i++) {
      snprintf(header, sizeof header, "{\"__metadata__\":{\"colour\":%s}}", values[i]);
      header_is(header, 0, DN_BAD_HEADER, i + 1 < sizeof values / sizeof *values ? "'colour'" : NULL);
      snprintf(header, sizeof header, "{\"tensor\":%s}", i < 6 || (i > 6 && i != 8) ? values[i] : "0");
      header_is(header, 0, DN_BAD_HEADER, "'tensor'");
   }
   for (i = 0; i < sizeof whole / sizeof *whole; i++) {
      snprintf(header, sizeof header, "{\"__metadata__\":%s}", whole[i]);
      header_is(header, 0, DN_BAD_HEADER, NULL);
   }
   { /* and in a model: every value that the loader reads, wrong in turn */
      static const char *const from[] = {"\"deformnet.version\":\"1\"", "\"deformnet.unit\":\"1\"", "\"mlp\"", "\"relative,normal\"", "\"root\""};
      static const char *const to[][4] = {{"\"deformnet.version\":\"2\"", "\"deformnet.version\":\"\"", "\"deformnet.versio\":\"11\"", "\"deformnet.version\":\"x\""},
         {"\"deformnet.unit\":\"0\"", "\"deformnet.unit\":\"-\"", "\"deformnet.unit\":\"x\"", "\"deformnet.unit\":\"\""}, {"\"mlq\"", "\"ML\"", "\"\"", "\"ml,\""},
         {"\"relative,\"", "\"\"", "\"normal\"", "\"relative,normal,\""}, {"\"rood\"", "\"Root\"", "\"\"", "\"root \""}};
      size_t size, k, refusals = 0;
      unsigned char *model = tiny_mlp(&size);
      for (i = 0; i < 5; i++)
         for (k = 0; k < 4; k++) {
            char *text = (char *)test_block(size + 64), *at;
            unsigned char *file;
            size_t header_size = (size_t)model[0] | (size_t)model[1] << 8, n;
            dn_error e;
            dn_model *m;
            memcpy(text, model + 8, header_size);
            text[header_size] = 0;
            at = strstr(text, from[i]);
            if (CHECK(at != NULL)) {
               memmove(at + strlen(to[i][k]), at + strlen(from[i]), strlen(at + strlen(from[i])) + 1);
               memcpy(at, to[i][k], strlen(to[i][k]));
               file = tiny_join(text, 0, model + 8 + header_size, size - 8 - header_size, &n);
               memset(&e, 0, sizeof e);
               m = dn_model_load(file, n, NULL, NULL, &e);
               CHECK_MSG(!m && e.code && strstr(e.info, "deformnet."), "%s: %s", to[i][k], m ? "accepted" : e.info);
               refusals += !m;
               dn_model_free(m);
               free(file);
            }
            free(text);
         }
      free(model);
      AT_LEAST(refusals, 20, "models");
   }
   AT_LEAST(cases, 34, "headers");
}

/* --- whole models. A file that loads must then bind and give finite vertices */
static int survives(const unsigned char *file, size_t size, const tube *t, size_t *loaded, size_t *ran, const char *label, size_t at)
{
   dn_error e;
   counting c;
   dn_allocator a = counting_allocator(&c, -1);
   dn_model *m;
   int ok = 1;
   memset(&e, 0, sizeof e);
   m = dn_model_load(file, size, NULL, &a, &e);
   if (!m) ok &= CHECK_MSG(e.code != DN_OK && e.code < DN_RESULT_COUNT && e.where && e.info[0] && memchr(e.info, 0, sizeof e.info),
                           "%s at %lu: refused without a reason", label, (unsigned long)at);
   else {
      float out[TUBE_V * 3];
      dn_output info;
      dn_result r;
      size_t i, bad = 0;
      ++*loaded;
      r = tiny_deform(m, t, out, &info, &a, &e);
      if (r == DN_OK || r == DN_NOT_FINITE) {
         ++*ran;
         for (i = 0; i < TUBE_V * 3; i++) bad += !test_finite(out[i]);
         ok &= CHECK_MSG(bad == 0, "%s at %lu: %lu numbers are not finite", label, (unsigned long)at, (unsigned long)bad);
         ok &= CHECK_MSG((r == DN_NOT_FINITE) == (info.fallback_nodes > 0), "%s at %lu: %s with %lu nodes", label, (unsigned long)at,
                         dn_result_text(r), (unsigned long)info.fallback_nodes);
      } else ok &= CHECK_MSG(e.info[0], "%s at %lu: no bind, no reason", label, (unsigned long)at);
   }
   dn_model_free(m);
   ok &= CHECK_MSG(c.live == 0 && c.wrong == 0, "%s at %lu: %ld blocks live, %lu wrong calls", label, (unsigned long)at, c.live, (unsigned long)c.wrong);
   return ok;
}
TEST(t12_every_prefix_and_every_flipped_byte)
{
   static const unsigned char masks[] = {0x01, 0x02, 0x04, 0x08, 0x10, 0x20, 0x40, 0x80, 0xff, 0x55};
   size_t file_index, size, n, k, prefixes = 0, flips = 0, loaded = 0, ran = 0, whole = 0;
   tube t;
   tube_make(&t);
   for (file_index = 0; file_index < 3; file_index++) {
      unsigned char *file = file_index == 0 ? tiny_mlp(&size) : tiny_multires("distance", file_index == 1 ? "dynamic" : "rest", &size);
      size_t none = 0, before = ran;
      survives(file, size, &t, &whole, &ran, "the whole file", 0);
      if (!CHECK_MSG(ran == before + 1, "the model itself must run")) return;
      for (n = 0; n < size; n++, prefixes++) { /* a block of its own: a sanitizer guards its exact end */
         unsigned char *cut = test_copy(file, n);
         survives(cut, n, &t, &none, &none, "cut", n);
         free(cut);
      }
      CHECK_MSG(none == 0, "%lu prefixes were taken for a whole file", (unsigned long)none);
      for (n = 0; n < size; n++)
         for (k = 0; k < sizeof masks; k += file_index == 2 ? 9 : 1, flips++) { /* the third only as its complement */
            unsigned char was = file[n];
            file[n] ^= masks[k];
            survives(file, size, &t, &loaded, &ran, "flip", n);
            file[n] = was;
         }
      for (n = 8; n < 8 + ((size_t)file[0] | (size_t)file[1] << 8) && file_index < 2; n++) { /* the header, with what JSON is made of */
         static const char structure[] = "{}[],:\"\\0-9. \n\0\x80u";
         for (k = 0; k < sizeof structure - 1; k++, flips++) {
            unsigned char was = file[n];
            file[n] = (unsigned char)structure[k];
            survives(file, size, &t, &loaded, &ran, "replaced", n);
            file[n] = was;
         }
      }
      free(file);
   }
   AT_LEAST(prefixes, 8000, "prefixes");
   AT_LEAST(flips, 100000, "flips");
   AT_LEAST(loaded, 10000, "loaded");
   AT_LEAST(ran, 10000, "ran");
}

TEST(t13_odd_addresses)
{
   size_t size, k, n, shifts = 0;
   tube t;
   unsigned char *file = tiny_multires("distance", "dynamic", &size);
   float expected[TUBE_V * 3], out[TUBE_V * 3];
   dn_error e;
   dn_model *m = dn_model_load(file, size, NULL, NULL, &e);
   tube_make(&t);
   if (!CHECK(m && tiny_deform(m, &t, expected, NULL, NULL, &e) == DN_OK)) return;
   dn_model_free(m);
   for (k = 0; k < 16; k++) /* the file moved, and its data moved against its start by spaces in the header */
      for (n = 0; n < 8; n++, shifts++) {
         size_t header = (size_t)file[0] | (size_t)file[1] << 8, total = size + n, i;
         unsigned char *block = (unsigned char *)test_aligned(total + k), *moved = block + k;
         memcpy(moved + 8, file + 8, header);
         memset(moved + 8 + header, ' ', n);
         memcpy(moved + 8 + header + n, file + 8 + header, size - 8 - header);
         for (i = 0; i < 8; i++) moved[i] = (unsigned char)((uint64_t)(header + n) >> (8 * i));
         m = dn_model_load(moved, total, NULL, NULL, &e);
         memset(block, 0xa5, total + k); /* the model must not look at the file again */
         if (CHECK_MSG(m != NULL, "shift %lu + %lu: %s", (unsigned long)k, (unsigned long)n, m ? "" : e.info)) {
            CHECK(tiny_deform(m, &t, out, NULL, NULL, &e) == DN_OK);
            CHECK_MSG(!memcmp(out, expected, sizeof out), "shift %lu + %lu changes the result", (unsigned long)k, (unsigned long)n);
         }
         dn_model_free(m);
         test_aligned_free(block);
      }
   { /* the caller's arrays at odd strides and addresses */
      unsigned char *block = (unsigned char *)test_block(TUBE_V * 37 + 16);
      size_t v;
      for (k = 0; k < 4; k++) {
         dn_rig_desc d = t.desc;
         dn_skin_set s = t.skin;
         unsigned char *p = block + k;
         dn_rig *rig;
         for (v = 0; v < TUBE_V; v++) {
            memcpy(p + v * 37, t.positions + 3 * v, 12);
            memcpy(p + v * 37 + 13, t.joints + 2 * v, 2);
            memcpy(p + v * 37 + 17, t.weights + 2 * v, 8);
         }
         s.joints = p + 13, s.joint_stride = 37;
         s.weights = p + 17, s.weight_stride = 37;
         d.mesh.position_stride = 37;
         memcpy(&d.mesh.positions, &p, sizeof p); /* an odd float pointer: only its bytes may be read */
         d.mesh.skin = &s;
         rig = dn_rig_create(NULL, &d, NULL, NULL, &e);
         if (CHECK_MSG(rig != NULL, "%s", rig ? "" : e.info)) {
            dn_rig_view view;
            dn_rig_describe(rig, &view);
            CHECK(view.vertices == TUBE_V && view.nodes == TUBE_V && !memcmp(view.rest, t.positions, sizeof t.positions));
         }
         dn_rig_free(rig);
         shifts++;
      }
      free(block);
   }
   free(file);
   AT_LEAST(shifts, 132, "shifts");
}

/* where a tensor's bytes lie in a file */
static unsigned char *data_of(unsigned char *file, size_t size, const char *name, size_t *count)
{
   size_t bytes;
   dn_tensors *t;
   const dn_tensor *x = NULL;
   void *memory;
   ptrdiff_t at = 0;
   if (!CHECK(dn_tensors_size(file, size, &bytes, NULL) == DN_OK)) return NULL;
   memory = test_aligned(bytes);
   if (CHECK(dn_tensors_open(file, size, memory, bytes, &t, NULL) == DN_OK)) x = dn_tensors_find(t, name);
   if (CHECK_MSG(x != NULL, "%s is not there", name)) at = x->data - file, *count = x->count;
   test_aligned_free(memory);
   return x ? file + at : NULL;
}
TEST(t14_weights_that_are_not_numbers)
{
   static const uint32_t bits[] = {0x7fc00000u /* NaN */, 0xffc00001u, 0x7f800001u /* signalling */, 0x7f800000u /* inf */, 0xff800000u, 0x00000001u /* denormal */,
      0x807fffffu, 0x7f7fffffu /* largest */, 0xff7fffffu, 0x00800000u /* smallest */, 0x80000000u /* -0 */, 0};
   static const char *const names[] = {"pre.0.weight", "pre.0.bias", "pre.0.bn.weight", "pre.0.bn.bias", "pre.0.bn.running_mean", "pre.0.bn.running_var",
      "local.0.lin.weight", "local.0.att_dst", "local.0.att_src", "local.0.self.weight", "pool.lin.weight", "pool.att_dst", "pool.att_src", "global.0.lin.weight",
      "global.1.att_src", "post.0.weight", "out.weight", "out.bias", "output.std", "output.mean"};
   size_t i, k, n, count = 0, size, loaded = 0, ran = 0, refusals = 0;
   unsigned char *file = tiny_multires("distance", "dynamic", &size), *kept = test_copy(file, size);
   tube t;
   tube_make(&t);
   for (i = 0; i < sizeof names / sizeof *names; i++)
      for (k = 0; k < sizeof bits / sizeof *bits; k++) {
         unsigned char *p = data_of(file, size, names[i], &count);
         size_t before = loaded, all;
         for (all = 0; p && all < 2; all++) { /* one element, then all of them */
            for (n = 0; n < (all ? count : 1); n++) {
               p[4 * n] = (unsigned char)bits[k], p[4 * n + 1] = (unsigned char)(bits[k] >> 8);
               p[4 * n + 2] = (unsigned char)(bits[k] >> 16), p[4 * n + 3] = (unsigned char)(bits[k] >> 24);
            }
            survives(file, size, &t, &loaded, &ran, names[i], k);
         }
         if (k < 5) { /* not finite: the error names the tensor */
            dn_error e;
            dn_model *m = dn_model_load(file, size, NULL, NULL, &e);
            CHECK_MSG(!m && loaded == before && e.code == DN_BAD_VALUE && strstr(e.info, names[i]), "%s: %s", names[i], m ? "accepted" : e.info);
            dn_model_free(m);
            refusals++;
         }
         memcpy(file, kept, size);
      }
   for (k = 0; k < 4; k++) { /* variances and deviations of zero or below */
      static const uint32_t low[] = {0, 0x80000000u, 0xbf800000u /* -1 */, 0x00000001u};
      static const char *const spreads[] = {"pre.0.bn.running_var", "output.std"};
      for (i = 0; i < 2; i++) {
         unsigned char *p = data_of(file, size, spreads[i], &count);
         if (!p) continue;
         p[0] = (unsigned char)low[k], p[1] = 0, p[2] = (unsigned char)(low[k] >> 16), p[3] = (unsigned char)(low[k] >> 24);
         survives(file, size, &t, &loaded, &ran, spreads[i], k);
         memcpy(file, kept, size);
      }
   }
   free(file);
   free(kept);
   file = tiny_mlp(&size);
   for (k = 0; k < 4; k++) {
      static const uint32_t low[] = {0, 0x80000000u, 0xbf800000u, 0x00000001u};
      unsigned char *p = data_of(file, size, "input.std", &count);
      if (!p) continue;
      p[0] = (unsigned char)low[k], p[1] = 0, p[2] = (unsigned char)(low[k] >> 16), p[3] = (unsigned char)(low[k] >> 24);
      survives(file, size, &t, &loaded, &ran, "input.std", k);
   }
   free(file);
   AT_LEAST(refusals, 100, "refused");
   AT_LEAST(ran, 200, "ran");
}

/* the parts of "load, bind, deform" that allocate, with the k-th allocation failing */
static dn_result load_and_bind(const unsigned char *file, size_t size, const tube *t, dn_allocator *a, dn_error *err)
{
   dn_model *m = dn_model_load(file, size, NULL, a, err);
   dn_report report;
   dn_rig *rig;
   void *scratch = NULL;
   size_t bytes = 0;
   dn_result r;
   if (!m) return err->code;
   rig = dn_rig_create(m, &t->desc, a, &report, err);
   if (rig) scratch = dn_scratch_create(rig, 2, a, &bytes, err);
   r = scratch ? DN_OK : err->code;
   dn_scratch_free(scratch, bytes, a);
   dn_rig_free(rig);
   dn_model_free(m);
   return r;
}
static void *misaligned(void *user, size_t size, size_t align) /* a careless allocator: four bytes off */
{
   unsigned char *p = (unsigned char *)malloc(size + align + 4);
   ++*(size_t *)user;
   return p ? p + 4 : NULL;
}
static void misaligned_free(void *user, void *ptr, size_t size)
{
   (void)size;
   --*(size_t *)user;
   free((unsigned char *)ptr - 4);
}
typedef struct cancel { long at, calls; float last; int falls; } cancel;
static int cancel_step(void *user, const char *stage, float done)
{
   cancel *c = (cancel *)user;
   c->falls += !stage || !(done >= 0.0f && done <= 1.0f);
   c->last = done;
   return c->calls++ == c->at;
}
TEST(t15_allocations_that_fail)
{
   static const char *const features[] = {"distance", "geodesic"};
   size_t f, size, failed = 0, cancelled = 0;
   long k;
   tube t;
   tube_make(&t);
   for (f = 0; f < 4; f++) {
      unsigned char *file = tiny_multires(features[f % 2], f < 2 ? "dynamic" : "rest", &size);
      counting c;
      dn_error e;
      dn_result r = DN_NO_MEMORY;
      cancel stop;
      dn_progress progress;
      for (k = 0; r == DN_NO_MEMORY && k < 1000; k++) {
         dn_allocator a = counting_allocator(&c, k);
         c.fill = (int)(k & 1 ? 0xff : 0);
         memset(&e, 0, sizeof e);
         r = load_and_bind(file, size, &t, &a, &e);
         failed += r != DN_OK;
         CHECK_MSG(r == DN_OK ? c.calls <= k : r == DN_NO_MEMORY && e.info[0], "allocation %ld fails: %s, %s", k, dn_result_text(r), e.info);
         CHECK_MSG(c.live == 0 && c.bytes == 0 && c.wrong == 0, "allocation %ld fails: %ld live, %lu wrong", k, c.live, (unsigned long)c.wrong);
      }
      CHECK_MSG(r == DN_OK && k >= 6, "%ld allocations, then %s", k, r ? e.info : "fine");
      { /* an allocator that does not align: refused, and everything is given back */
         size_t live = 0;
         dn_allocator a;
         a.alloc = misaligned, a.free = misaligned_free, a.user = &live;
         CHECK(load_and_bind(file, size, &t, &a, &e) == DN_NO_MEMORY && live == 0);
      }
      r = DN_CANCELLED;
      for (k = 0; r == DN_CANCELLED && k < 10000; k++) { /* cancelled at the k-th report of progress: as clean */
         dn_allocator a = counting_allocator(&c, -1);
         stop.at = k, stop.calls = 0, stop.falls = 0;
         progress.step = cancel_step;
         progress.user = &stop;
         t.desc.progress = &progress;
         r = load_and_bind(file, size, &t, &a, &e);
         t.desc.progress = NULL;
         cancelled += r == DN_CANCELLED;
         CHECK_MSG((r == DN_OK || r == DN_CANCELLED) && stop.falls == 0, "cancelled at %ld: %s", k, r ? e.info : "");
         /* the last report, of 1, comes when all is done: too late to cancel */
         CHECK_MSG(r == DN_CANCELLED ? stop.calls == k + 1 : stop.calls <= k + 1 && stop.last >= 1.0f, "cancelled at %ld: %ld reports, the last of %g", k, stop.calls,
                   (double)stop.last);
         CHECK_MSG(c.live == 0 && c.wrong == 0, "cancelled at %ld: %ld live", k, c.live);
      }
      CHECK(r == DN_OK);
      { /* the path without an allocator: each size one byte short, then exact */
         size_t table = 0, bytes = 0, scratch = 0, rig_bytes = 0, rig_scratch = 0;
         dn_tensors *view = NULL;
         dn_model *m = NULL;
         dn_rig *rig = NULL;
         void *p[5];
         CHECK(dn_tensors_size(file, size, &table, &e) == DN_OK);
         p[0] = test_aligned(table);
         CHECK(dn_tensors_open(file, size, p[0], table, &view, &e) == DN_OK);
         CHECK(dn_model_size(view, NULL, &bytes, &scratch, &e) == DN_OK && bytes && scratch);
         p[1] = test_aligned(bytes), p[2] = test_aligned(scratch);
         memset(p[1], 0xa5, bytes), memset(p[2], 0x5a, scratch);
         CHECK(dn_model_init(view, NULL, p[1], bytes - 1, p[2], scratch, &m, &e) == DN_TOO_SMALL && !m && e.info[0]);
         CHECK(dn_model_init(view, NULL, p[1], bytes, p[2], scratch - 1, &m, &e) == DN_TOO_SMALL && !m && e.info[0]);
         CHECK(dn_model_init(view, NULL, p[1], bytes, p[2], scratch, &m, &e) == DN_OK && m);
         CHECK(dn_rig_size(m, &t.desc, &rig_bytes, &rig_scratch, &e) == DN_OK && rig_bytes && rig_scratch);
         p[3] = test_aligned(rig_bytes), p[4] = test_aligned(rig_scratch);
         memset(p[3], 0xa5, rig_bytes), memset(p[4], 0x5a, rig_scratch);
         CHECK(dn_rig_init(m, &t.desc, p[3], 64, p[4], rig_scratch, &rig, NULL, &e) == DN_TOO_SMALL && !rig && e.info[0]);
         CHECK(dn_rig_init(m, &t.desc, p[3], rig_bytes, p[4], 64, &rig, NULL, &e) == DN_TOO_SMALL && !rig && e.info[0]);
         CHECK_MSG(dn_rig_init(m, &t.desc, p[3], rig_bytes, p[4], rig_scratch, &rig, NULL, &e) == DN_OK && rig, "%s", e.info);
         if (rig) { /* the frame: too small a scratch writes nothing, an exact one is enough */
            float out[TUBE_V * 3];
            dn_pose pose;
            dn_output o;
            size_t need = dn_scratch_size(rig, 1), i, touched = 0;
            void *frame = test_aligned(need);
            memset(&pose, 0, sizeof pose), memset(&o, 0, sizeof o);
            for (i = 0; i < TUBE_V * 3; i++) out[i] = 7.0f;
            pose.palette = t.palette, pose.strength = 1.0f;
            o.positions = out;
            CHECK(dn_deform(rig, &pose, &o, frame, need - 1, NULL, &e) == DN_TOO_SMALL && e.info[0]);
            CHECK(dn_deform(rig, &pose, &o, frame, 0, NULL, &e) == DN_TOO_SMALL);
            for (i = 0; i < TUBE_V * 3; i++) touched += out[i] < 7.0f || out[i] > 7.0f;
            CHECK(touched == 0);
            CHECK(dn_deform(rig, &pose, &o, frame, need, NULL, &e) == DN_OK);
            test_aligned_free(frame);
         }
         for (k = 0; k < 5; k++) test_aligned_free(p[k]);
      }
      free(file);
   }
   dn_model_free(NULL);
   dn_rig_free(NULL);
   AT_LEAST(failed, 20, "failures");
   AT_LEAST(cancelled, 8, "cancellations");
}

/* scattered vertices that weld within a third of the body: nodes span another box than the vertices did, and the scratch
   that was sized from the counts and the box must still do */
/* kernels and precisions that are there, are not there, and are none */
TEST(options_of_loading)
{
   size_t size, loaded = 0, refused = 0;
   int k;
   unsigned char *file = tiny_multires("geodesic", "rest", &size);
   dn_model_options o;
   dn_model_info info;
   dn_error e;
   dn_model *m = dn_model_load(file, size, NULL, NULL, &e);
   dn_model_describe(m, &info);
   CHECK(info.precision == DN_PRECISION_F32 && dn_kernel_available(info.kernel));
   CHECK(strcmp(dn_kernel_name(info.kernel), dn_kernel_name(DN_KERNEL_AUTO)) == 0);
   dn_model_free(m);
   for (k = 0; k <= DN_KERNEL_COUNT; k++) {
      memset(&o, 0, sizeof o);
      memset(&e, 0, sizeof e);
      o.kernel = (dn_kernel)k;
      m = dn_model_load(file, size, &o, NULL, &e);
      CHECK((m != NULL) == (k == DN_KERNEL_AUTO || dn_kernel_available(o.kernel)));
      if (m) {
         dn_model_describe(m, &info);
         CHECK(k == DN_KERNEL_AUTO ? dn_kernel_available(info.kernel) : info.kernel == o.kernel);
         CHECK(m->blocks[0].linear.kernel == info.kernel);
         loaded++;
      } else {
         CHECK_MSG(e.code == DN_UNSUPPORTED && strstr(e.info, "options.kernel") && strstr(e.info, "reference"), "%s", e.info);
         refused++;
      }
      dn_model_free(m);
   }
   AT_LEAST(loaded, 2, "kernels loaded for");
   AT_LEAST(refused, 2, "kernels refused");
   memset(&o, 0, sizeof o);
   o.precision = DN_PRECISION_COUNT;
   m = dn_model_load(file, size, &o, NULL, &e);
   CHECK_MSG(!m && e.code == DN_UNSUPPORTED && strstr(e.info, "options.precision") && strstr(e.info, "f32"), "%s", e.info);
   free(file);
}
TEST(t15_scratch_under_a_weld_distance)
{
   uint64_t seed = 7;
   size_t size, round, v, bound = 0;
   unsigned char *file = tiny_multires("geodesic", "rest", &size);
   dn_error e;
   dn_model *m = dn_model_load(file, size, NULL, NULL, &e);
   tube t;
   for (round = 0; m && round < 400; round++) {
      dn_rig *rig;
      tube_make(&t);
      for (v = 0; v < TUBE_V * 3; v++) t.positions[v] = test_uniform(&seed, 0.0f, v % 3 == 0 ? 1.0f : 0.9f);
      t.desc.weld_distance = test_uniform(&seed, 0.05f, 0.4f);
      t.desc.resolution = 8 + test_random(&seed) % 40;
      memset(&e, 0, sizeof e);
      rig = dn_rig_create(m, &t.desc, NULL, NULL, &e);
      CHECK_MSG(rig, "round %lu: %s", (unsigned long)round, e.info);
      bound += rig != NULL;
      dn_rig_free(rig);
   }
   AT_LEAST(bound, 400, "bound");
   dn_model_free(m);
   free(file);
   CHECK(!dn_model_load_file(".", NULL, NULL, &e) && e.code == DN_IO && e.info[0]); /* a folder is not a file */
   CHECK(!dn_model_load_file("no such file", NULL, NULL, &e) && e.code == DN_IO && strstr(e.info, "no such file"));
}

TEST(t16_declared_sizes)
{
   static const char *const shapes[] = {"[1000000000]", "[65536,65536]", "[65535,65535,65535]", "[2147483647]", "[4294967295]", "[1000000,1000000]"};
   size_t i, size, models = 0;
   cases = 0;
   for (i = 0; i < sizeof shapes / sizeof *shapes; i++) { /* refused() bounds what was allocated on the way */
      header_is("{}", 0, DN_OK, NULL);
      tensor_is("\"F32\"", shapes[i], "[0,4]", 4, sizeof(size_t) > 4 ? DN_BAD_LAYOUT : i == 4 ? DN_BAD_HEADER : DN_BAD_SHAPE, "tensor 'a'");
   }
   for (i = 0; i < 4; i++) { /* the shapes that cost most memory for a number: one wide layer with one output, many heads */
      static tiny_writer w;
      uint64_t seed = 3;
      unsigned char *file;
      counting c;
      dn_allocator a = counting_allocator(&c, -1);
      dn_error e;
      dn_model *m;
      tiny_begin(&w, TINY_META "\"deformnet.features\":\"relative\"");
      w.used = (size_t)snprintf(w.header, sizeof w.header, "{\"__metadata__\":{" TINY_META "\"deformnet.arch\":\"%s\",\"deformnet.features\":\"relative\"}",
                                i < 2 ? "mlp" : "gat");
      if (i == 0) {
         tiny_tensor(&w, "pre.0.weight", 4000, 3, &seed, -1, 1);
         tiny_tensor(&w, "pre.1.weight", 1, 4000, &seed, -1, 1);
         tiny_tensor(&w, "out.weight", 3, 1, &seed, -1, 1);
      } else if (i == 1) {
         char name[32];
         size_t k;
         for (k = 0; k < 60; k++) {
            snprintf(name, sizeof name, "pre.%lu.weight", (unsigned long)k);
            tiny_tensor(&w, name, 1, k ? 1 : 3, &seed, -1, 1);
         }
         tiny_tensor(&w, "out.weight", 3, 1, &seed, -1, 1);
      } else {
         tiny_tensor(&w, "gat.0.lin.weight", 1000, 3, &seed, -1, 1);
         tiny_tensor(&w, "gat.0.att_dst", i == 2 ? 1000 : 1, i == 2 ? 1 : 1000, &seed, -1, 1);
         tiny_tensor(&w, "gat.0.att_src", i == 2 ? 1000 : 1, i == 2 ? 1 : 1000, &seed, -1, 1);
         tiny_tensor(&w, "out.weight", 3, 1000, &seed, -1, 1);
      }
      file = tiny_file(&w, &size);
      memset(&e, 0, sizeof e);
      m = dn_model_load(file, size, NULL, &a, &e);
      CHECK_MSG(m != NULL, "model %lu: %s", (unsigned long)i, m ? "" : e.info);
      CHECK_MSG(c.total <= 24 * size + 16384, "model %lu: %lu bytes for a file of %lu", (unsigned long)i, (unsigned long)c.total, (unsigned long)size);
      models += m != NULL;
      dn_model_free(m);
      CHECK(c.live == 0 && c.wrong == 0);
      free(file);
   }
   { /* a side over DN_MAX_DIM is refused even where its data is there */
      size_t n = DN_MAX_DIM + 1, bytes = 4 * (n * 3 + n * 3);
      char header[1024];
      unsigned char *data = (unsigned char *)test_block(bytes), *file;
      dn_error e;
      dn_model *m;
      memset(data, 0, bytes);
      snprintf(header, sizeof header, "{\"__metadata__\":{" TINY_META "\"deformnet.arch\":\"mlp\",\"deformnet.features\":\"relative\"},"
               "\"pre.0.weight\":{\"dtype\":\"F32\",\"shape\":[%lu,3],\"data_offsets\":[0,%lu]},\"out.weight\":{\"dtype\":\"F32\",\"shape\":[3,%lu],\"data_offsets\":[%lu,%lu]}}",
               (unsigned long)n, (unsigned long)(12 * n), (unsigned long)n, (unsigned long)(12 * n), (unsigned long)(24 * n));
      file = tiny_join(header, 0, data, bytes, &size);
      m = dn_model_load(file, size, NULL, NULL, &e);
      CHECK_MSG(!m && e.code == DN_BAD_SHAPE && strstr(e.info, "pre.0.weight"), "%s", m ? "accepted" : e.info);
      dn_model_free(m);
      free(file);
      free(data);
   }
   AT_LEAST(cases, 12, "headers");
   AT_LEAST(models, 4, "models");
}

/* --- the caller's mesh */
static size_t meshes;
static void mesh_is(tube *t, dn_result code, size_t offset, const char *label)
{
   size_t size, pass;
   unsigned char *file = tiny_multires("geodesic", "rest", &size);
   dn_error e;
   dn_model *m = dn_model_load(file, size, NULL, NULL, &e);
   free(file);
   if (!CHECK(m != NULL)) return;
   for (pass = 0; pass < 2; pass++) { /* with a network, and skinning only */
      counting c;
      dn_allocator a = counting_allocator(&c, -1);
      dn_rig *rig;
      memset(&e, 0, sizeof e);
      rig = dn_rig_create(pass ? NULL : m, &t->desc, &a, NULL, &e);
      if (code == DN_OK) {
         float out[TUBE_V * 3 + 3];
         dn_output info;
         dn_result r;
         size_t i, bad = 0;
         CHECK_MSG(rig != NULL, "%s: %s", label, rig ? "" : e.info);
         dn_rig_free(rig);
         rig = NULL;
         r = tiny_deform(pass ? NULL : m, t, out, &info, &a, &e);
         CHECK_MSG(r == DN_OK, "%s: %s", label, dn_result_text(r));
         for (i = 0; i < 3 * t->desc.mesh.vertices; i++) bad += !test_finite(out[i]);
         CHECK_MSG(bad == 0, "%s: %lu numbers are not finite", label, (unsigned long)bad);
      } else CHECK_MSG(!rig && e.code == code && e.offset == offset && e.info[0], "%s: %s, \"%s\" at %lu, expected %s at %lu", label, rig ? "accepted" :
                       dn_result_text(e.code), e.info, (unsigned long)e.offset, dn_result_text(code), (unsigned long)offset);
      dn_rig_free(rig);
      CHECK_MSG(c.live == 0 && c.wrong == 0, "%s: %ld live, %lu wrong", label, c.live, (unsigned long)c.wrong);
   }
   dn_model_free(m);
   meshes++;
}
static dn_report report_of(const tube *t)
{
   dn_report report;
   dn_error e;
   dn_rig *rig;
   memset(&report, 0xff, sizeof report);
   rig = dn_rig_create(NULL, &t->desc, NULL, &report, &e);
   CHECK_MSG(rig != NULL, "%s", rig ? "" : e.info);
   dn_rig_free(rig);
   return report;
}
TEST(t17_meshes)
{
   static const uint32_t strange[] = {0x7fc00000u, 0x7f800000u, 0xff800000u};
   tube t;
   dn_report r;
   size_t i, k;
   meshes = 0;
   tube_make(&t), mesh_is(&t, DN_OK, 0, "the tube itself");
   for (i = 0; i < TUBE_T * 3; i += 7) {
      tube_make(&t), t.indices[i] = TUBE_V, mesh_is(&t, DN_BAD_MESH, i / 3, "index V");
      tube_make(&t), t.indices[i] = 65535, mesh_is(&t, DN_BAD_MESH, i / 3, "index 65535");
   }
   for (i = 0; i < 4; i++) { /* 32-bit indices, among them those that come out negative */
      static const uint32_t bad[4] = {TUBE_V, 0x7fffffffu, 0x80000000u, 0xffffffffu};
      static uint32_t wide[TUBE_T * 3];
      tube_make(&t);
      for (k = 0; k < TUBE_T * 3; k++) wide[k] = t.indices[k];
      wide[100] = bad[i];
      t.desc.mesh.indices = wide, t.desc.mesh.index_type = DN_U32;
      mesh_is(&t, DN_BAD_MESH, 33, "32-bit index");
   }
   for (i = 0; i < TUBE_V * 2; i += 5) {
      tube_make(&t), t.joints[i] = TUBE_S, t.weights[i] = 0.25f, mesh_is(&t, DN_BAD_SKIN, i / 2, "joint S");
      tube_make(&t), t.joints[i] = 255, t.weights[i] = 1e-30f, mesh_is(&t, DN_BAD_SKIN, i / 2, "joint 255 of next to no weight");
      tube_make(&t), t.joints[i] = 255, t.weights[i] = 0, mesh_is(&t, DN_OK, 0, "joint 255 of no weight, as exporters pad");
   }
   for (k = 0; k < 3; k++)
      for (i = 0; i < TUBE_V; i += 11) {
         tube_make(&t), memcpy(&t.weights[2 * i], &strange[k], 4), mesh_is(&t, DN_BAD_SKIN, i, "weight not finite");
         tube_make(&t), memcpy(&t.positions[3 * i + k], &strange[k], 4), mesh_is(&t, DN_BAD_MESH, i, "position not finite");
      }
   tube_make(&t), t.desc.mesh.vertices = 0, t.desc.mesh.triangles = 0, mesh_is(&t, DN_BAD_MESH, SIZE_MAX, "no vertices");
   tube_make(&t), t.desc.mesh.triangles = 0, t.desc.mesh.indices = NULL, mesh_is(&t, DN_OK, 0, "no triangles");
   tube_make(&t), t.desc.mesh.vertices = 1, t.desc.mesh.triangles = 0, mesh_is(&t, DN_OK, 0, "one vertex");
   tube_make(&t), t.desc.mesh.triangles = 1, mesh_is(&t, DN_OK, 0, "one triangle, the rest alone");
   tube_make(&t), memset(t.positions, 0, sizeof t.positions), mesh_is(&t, DN_OK, 0, "all vertices in one point");
   tube_make(&t), memset(t.indices, 0, sizeof t.indices), mesh_is(&t, DN_OK, 0, "only degenerate triangles");
   for (i = 0; i < TUBE_V; i++) tube_make(&t), t.positions[3 * i] = 1e30f, mesh_is(&t, DN_OK, 0, "one vertex very far away"), i += 20;
   tube_make(&t);
   for (i = 0; i < TUBE_V * 3; i++) t.positions[i] *= 1e-30f;
   mesh_is(&t, DN_OK, 0, "a mesh of 1e-30 metres");
   tube_make(&t);
   for (i = 0; i < TUBE_V; i++) t.positions[3 * i + 2] = 0;
   mesh_is(&t, DN_OK, 0, "a flat mesh");

   tube_make(&t), r = report_of(&t);
   CHECK(r.vertices == TUBE_V && r.nodes == TUBE_V && r.components == 1 && r.isolated_nodes == 0 && r.degenerate_triangles == 0);
   CHECK(r.weights_normalised == 0 && r.weightless_vertices == 0 && r.influences_dropped == 0 && r.influences == 2);
   tube_make(&t), t.weights[0] = t.weights[1] = 0.0f, t.weights[4] = -1.0f, t.weights[5] = -0.0f, r = report_of(&t);
   CHECK_MSG(r.weightless_vertices == 2 && r.influences_dropped == 1, "%lu weightless, %lu dropped", (unsigned long)r.weightless_vertices, (unsigned long)r.influences_dropped);
   mesh_is(&t, DN_OK, 0, "no weight");
   tube_make(&t), t.weights[0] = 3.0f, t.weights[1] = 1.0f, t.weights[2] = 1e-30f, t.weights[3] = 0.0f, r = report_of(&t);
   CHECK_MSG(r.weights_normalised == 2, "%lu normalised", (unsigned long)r.weights_normalised);
   tube_make(&t), t.weights[0] = t.weights[1] = 3e38f, mesh_is(&t, DN_OK, 0, "weights whose sum overflows");
   tube_make(&t), t.weights[0] = t.weights[1] = 1e-45f, mesh_is(&t, DN_OK, 0, "denormal weights");
   tube_make(&t), t.indices[1] = t.indices[0], r = report_of(&t);
   CHECK(r.degenerate_triangles == 1);
   tube_make(&t), memcpy(t.positions + 3, t.positions, 12), r = report_of(&t);
   CHECK_MSG(r.nodes == TUBE_V - 1 && r.seams_welded == 1, "%lu nodes", (unsigned long)r.nodes);
   tube_make(&t), memcpy(t.positions + 3, t.positions, 12), t.weights[2] = 0.5f, t.weights[3] = 0.5f, r = report_of(&t);
   CHECK_MSG(r.nodes == TUBE_V && r.seams_apart == 1, "%lu nodes, %lu apart", (unsigned long)r.nodes, (unsigned long)r.seams_apart);
   tube_make(&t), t.desc.mesh.triangles = 1, r = report_of(&t);
   CHECK_MSG(r.isolated_nodes == TUBE_V - 3 && r.components == TUBE_V - 2, "%lu alone, %lu components", (unsigned long)r.isolated_nodes, (unsigned long)r.components);
   tube_make(&t);
   for (i = 0; i < 30; i++) t.indices[3 * i] = t.indices[0], t.indices[3 * i + 1] = t.indices[1]; /* thirty faces on one edge */
   mesh_is(&t, DN_OK, 0, "a non-manifold edge");

   { /* the skeleton */
      size_t size;
      unsigned char *file = tiny_multires("geodesic", "dynamic", &size);
      static const char *const twice[TUBE_S] = {"hip", "hip", "foot"}, *const other[TUBE_S] = {"hip", "kneecap", "toe"}, *const prefix[TUBE_S] = {"mixamorig:hip", "Armature|knee", "foot"};
      static const float few[3] = {0};
      dn_error e;
      dn_model *m = dn_model_load(file, size, NULL, NULL, &e);
      dn_rig *rig;
      tube_make(&t), t.desc.skeleton.names = other;
      rig = dn_rig_create(m, &t.desc, NULL, NULL, &e);
      CHECK_MSG(!rig && e.code == DN_MISSING_JOINT && strstr(e.info, "knee") && strstr(e.info, "foot"), "%s", rig ? "accepted" : e.info);
      tube_make(&t), t.desc.skeleton.names = twice;
      rig = dn_rig_create(m, &t.desc, NULL, NULL, &e);
      CHECK_MSG(!rig && e.code == DN_MISSING_JOINT && strstr(e.info, "knee"), "%s", rig ? "accepted" : e.info);
      tube_make(&t), t.desc.skeleton.names = prefix;
      rig = dn_rig_create(m, &t.desc, NULL, NULL, &e);
      CHECK_MSG(rig != NULL, "%s", rig ? "" : e.info);
      dn_rig_free(rig);
      for (i = 0; i < 3; i++) { /* parents that form a ring, point outside, or at themselves */
         static const int32_t bad[3][TUBE_S] = {{1, 2, 0}, {-1, 7, -9}, {0, 1, 2}};
         counting c;
         dn_allocator a = counting_allocator(&c, -1);
         static const char *const extra[TUBE_S + 1] = {"hip", "knee", "foot", "hand"};
         int32_t parents[TUBE_S + 1];
         float inverse[12 * (TUBE_S + 1)];
         tube_make(&t);
         memcpy(parents, bad[i], sizeof bad[i]), memcpy(inverse, t.inverse_bind, sizeof t.inverse_bind), memcpy(inverse + 12 * TUBE_S, t.inverse_bind, 48);
         parents[TUBE_S] = i == 1 ? 3 : i == 0 ? 2 : 3;
         t.desc.skeleton.joints = TUBE_S + 1, t.desc.skeleton.names = extra, t.desc.skeleton.parents = parents, t.desc.skeleton.inverse_bind = inverse;
         memset(&e, 0, sizeof e);
         rig = dn_rig_create(m, &t.desc, &a, NULL, &e); /* accepted or refused, but neither endless nor outside */
         CHECK_MSG(rig || e.info[0], "parents %lu: no reason", (unsigned long)i);
         dn_rig_free(rig);
         CHECK(c.live == 0 && c.wrong == 0);
      }
      tube_make(&t), t.desc.geodesic = few, t.desc.geodesic_nodes = 1;
      rig = dn_rig_create(m, &t.desc, NULL, NULL, &e);
      CHECK_MSG(!rig && e.info[0], "distances of 1 node for 42: %s", rig ? "accepted" : e.info);
      tube_make(&t), memcpy(&t.inverse_bind[3], &strange[0], 4);
      rig = dn_rig_create(m, &t.desc, NULL, NULL, &e);
      CHECK_MSG(!rig && e.info[0], "inverse bind of NaN: %s", rig ? "accepted" : e.info);
      tube_make(&t), memset(t.inverse_bind, 0, sizeof t.inverse_bind);
      rig = dn_rig_create(m, &t.desc, NULL, NULL, &e); /* no inverse: refused or defined */
      CHECK(rig || e.info[0]);
      dn_rig_free(rig);
      dn_model_free(m);
      free(file);
   }
   AT_LEAST(meshes, 130, "meshes");
}

TEST(t18_palettes)
{
   static const uint32_t strange[] = {0x7fc00000u, 0x7f800000u, 0xff800000u};
   size_t size, f, k, i, j, poses = 0;
   tube t;
   for (f = 0; f < 6; f++) {
      unsigned char *file = f % 3 == 0 ? tiny_mlp(&size) : tiny_multires(f % 3 == 1 ? "distance" : "geodesic", "dynamic", &size);
      dn_error e;
      dn_model *m = dn_model_load(file, size, NULL, NULL, &e);
      dn_rig *rig;
      float out[TUBE_V * 3], normals[TUBE_V * 3];
      void *scratch;
      size_t bytes, bad, odd;
      dn_pose pose;
      dn_output o;
      dn_result r;
      free(file);
      tube_make(&t);
      t.desc.skinning = f < 3 ? DN_LBS : DN_DQS;
      rig = m ? dn_rig_create(m, &t.desc, NULL, NULL, &e) : NULL;
      if (!CHECK_MSG(rig != NULL, "%s", e.info)) return;
      bytes = dn_scratch_size(rig, 1);
      scratch = test_aligned(bytes);
      for (k = 0; k < 12 + TUBE_S * 3 * 12; k++, poses++) {
         size_t spoilt = TUBE_S;
         tube_make(&t);
         for (j = 0; j < TUBE_S; j++) {
            float *p = t.palette + 12 * j;
            switch (k) {
            case 0: memset(p, 0, 48); break;                                    /* all zero */
            case 1: if (j == 1) p[0] = p[1] = p[2] = p[4] = p[5] = p[6] = p[8] = p[9] = p[10] = 0; break;
            case 2: p[0] = -p[0], p[1] = -p[1], p[2] = -p[2]; break;            /* mirror */
            case 3: p[1] += 5.0f; break;                                        /* shear */
            case 4: p[3] += 1e6f; break;                                        /* far away */
            case 5: p[7] -= 1e12f; break;
            case 6: for (i = 0; i < 12; i++) p[i] *= 1e-20f; break;
            case 7: for (i = 0; i < 12; i++) p[i] *= 1e-42f; break;             /* denormal */
            case 8: for (i = 0; i < 12; i++) p[i] *= 1e15f; break;
            case 9: for (i = 0; i < 12; i++) p[i] = j & 1 ? -0.0f : 0.0f; break;
            case 10: p[0] = p[4] = p[8] = 1e-13f; break;                        /* an axis too short to normalise */
            case 11: p[1] = p[0], p[5] = p[4], p[9] = p[8]; break;              /* parallel axes */
            default: break;
            }
         }
         if (k >= 12) {
            spoilt = (k - 12) / 36;
            memcpy(&t.palette[12 * spoilt + (k - 12) % 12], &strange[(k - 12) / 12 % 3], 4);
         }
         memset(&pose, 0, sizeof pose), memset(&o, 0, sizeof o);
         for (i = 0; i < TUBE_V * 3; i++) out[i] = normals[i] = -77.0f;
         memset(scratch, 0xff, bytes); /* NaN everywhere */
         pose.palette = t.palette, pose.strength = 1.0f;
         o.positions = out, o.normals = normals;
         r = dn_deform(rig, &pose, &o, scratch, bytes, NULL, &e);
         if (k < 12) CHECK_MSG(r == DN_OK || r == DN_NOT_FINITE, "palette %lu: %s", (unsigned long)k, dn_result_text(r));
         else CHECK_MSG(r == DN_NOT_FINITE && e.code == DN_NOT_FINITE, "palette %lu is not finite: %s", (unsigned long)k, dn_result_text(r));
         for (i = 0, bad = 0, odd = 0; i < TUBE_V; i++) {
            int own = spoilt < TUBE_S && ((t.joints[2 * i] == spoilt && t.weights[2 * i] > 0) || (t.joints[2 * i + 1] == spoilt && t.weights[2 * i + 1] > 0));
            double length = 0;
            for (j = 0; j < 3; j++) { /* own: plainly skinned by a matrix that is not finite, which is the caller's own */
               if (!own) bad += !test_finite(out[3 * i + j]);
               length += (double)normals[3 * i + j] * (double)normals[3 * i + j];
            }
            odd += !(length == 0.0 || (length > 0.999 && length < 1.001));
         }
         CHECK_MSG(bad == 0, "model %lu, palette %lu: %lu numbers are not finite", (unsigned long)f, (unsigned long)k, (unsigned long)bad);
         CHECK_MSG(odd == 0, "model %lu, palette %lu: %lu normals are neither unit nor zero", (unsigned long)f, (unsigned long)k, (unsigned long)odd);
      }
      { /* strengths and masks outside [0,1] or not numbers: clamped, never spread */
         float mask[TUBE_V];
         for (k = 0; k < 5; k++, poses++) {
            static const uint32_t strengths[5] = {0x7fc00000u, 0x7f800000u, 0xbf800000u, 0x42c80000u, 0x3f000000u};
            tube_make(&t);
            memset(&pose, 0, sizeof pose), memset(&o, 0, sizeof o);
            memcpy(&pose.strength, &strengths[k], 4);
            for (i = 0; i < TUBE_V; i++) mask[i] = 1.0f;
            memcpy(&mask[k], &strengths[k], 4);
            pose.mask = mask, pose.palette = t.palette;
            o.positions = out;
            r = dn_deform(rig, &pose, &o, scratch, bytes, NULL, &e);
            for (i = 0, bad = 0; i < TUBE_V * 3; i++) bad += !test_finite(out[i]);
            CHECK_MSG((r == DN_OK || r == DN_NOT_FINITE) && bad == 0, "strength %lu: %s, %lu not finite", (unsigned long)k, dn_result_text(r), (unsigned long)bad);
         }
      }
      test_aligned_free(scratch);
      dn_rig_free(rig);
      dn_model_free(m);
   }
   AT_LEAST(poses, 700, "poses");
}

/* all halves, both kinds, as a hash: the same on every machine, in every mode */
static uint64_t halves_hash(void)
{
   static const char header[] = "{\"h\":{\"dtype\":\"F16\",\"shape\":[65536],\"data_offsets\":[0,131072]},\"b\":{\"dtype\":\"BF16\",\"shape\":[65536],\"data_offsets\":[131072,262144]},"
      "\"f\":{\"dtype\":\"F32\",\"shape\":[65536],\"data_offsets\":[262144,524288]},\"i\":{\"dtype\":\"I32\",\"shape\":[65536],\"data_offsets\":[262144,524288]}}";
   /* "f" and "i" share a range: legal only one at a time, so the header is opened twice with one of them renamed away */
   size_t size, bytes, i;
   unsigned char *data = (unsigned char *)test_block(524288), *file;
   float *out = (float *)test_block(65536 * sizeof(float));
   uint64_t h = 14695981039346656037u, seed = 9;
   int pass;
   for (i = 0; i < 65536; i++) {
      data[2 * i] = data[131072 + 2 * i] = (unsigned char)i;
      data[2 * i + 1] = data[131072 + 2 * i + 1] = (unsigned char)(i >> 8);
   }
   for (i = 262144; i < 524288; i++) data[i] = (unsigned char)(test_random(&seed) >> 7);
   for (pass = 0; pass < 2; pass++) {
      char text[512], *cut, *end;
      dn_tensors *t = NULL;
      void *memory;
      const dn_tensor *x;
      uint32_t u;
      size_t k;
      memcpy(text, header, sizeof header);
      cut = strstr(text, pass ? ",\"f\"" : ",\"i\"");
      end = strchr(cut + 1, '}') + 1;
      memmove(cut, end, strlen(end) + 1);
      file = tiny_join(text, 0, data, 524288, &size);
      CHECK(dn_tensors_size(file, size, &bytes, NULL) == DN_OK);
      memory = test_aligned(bytes);
      if (CHECK(dn_tensors_open(file, size, memory, bytes, &t, NULL) == DN_OK))
         for (k = 0; k < 3; k++) {
            x = dn_tensors_find(t, k == 0 ? "h" : k == 1 ? "b" : pass ? "i" : "f");
            if (!CHECK(x && x->count == 65536)) continue;
            if (k == 2 && pass) { /* integers as integers; as floats they round as the mode says beyond 2^24 */
               int32_t *ints = (int32_t *)(void *)out;
               dn_tensor_ints(x, 0, 65536, ints);
            } else {
               dn_tensor_floats(x, 0, 1000, out);
               dn_tensor_floats(x, 1000, 64536, out + 1000);
            }
            for (i = 0; i < 65536; i++) {
               unsigned char b[4];
               memcpy(&u, out + i, 4);
               b[0] = (unsigned char)u, b[1] = (unsigned char)(u >> 8), b[2] = (unsigned char)(u >> 16), b[3] = (unsigned char)(u >> 24);
               h = test_hash(h, b, 4);
            }
         }
      test_aligned_free(memory);
      free(file);
   }
   free(out);
   free(data);
   return h;
}
#define HALVES_HASH 0xb0840052d8eae141u

TEST(t19_locale_and_floating_point_modes)
{
   static const char *const locales[] = {"de_DE.UTF-8", "de_DE.utf8", "de_DE", "de_DE@euro", "fr_FR.UTF-8", "nl_NL.UTF-8"};
   size_t size, i, k, modes = 0;
   unsigned char *file = tiny_multires("distance", "dynamic", &size);
   float expected[TUBE_V * 3], out[TUBE_V * 3];
   tube t;
   dn_error e;
   dn_model *m = dn_model_load(file, size, NULL, NULL, &e);
   uint64_t hash = halves_hash();
   int comma = 0;
   tube_make(&t);
   if (!CHECK(m && tiny_deform(m, &t, expected, NULL, NULL, &e) == DN_OK)) return;
   dn_model_free(m);
   for (i = 0; i < sizeof locales / sizeof *locales && !comma; i++) comma = setlocale(LC_ALL, locales[i]) && localeconv()->decimal_point[0] == ',';
   printf("     t19: %s\n", comma ? "a locale with a decimal comma is set" : "no locale with a decimal comma here (builds.sh makes one)");
   for (i = 0; i < 8; i++, modes++) { /* four rounding modes, with and without flushing denormals to zero */
      static const int rounding[4] = {FE_TONEAREST, FE_UPWARD, FE_DOWNWARD, FE_TOWARDZERO};
      dn_model_info info;
      size_t bad = 0;
#if defined(__SSE__) || defined(_M_X64)
      unsigned csr = _mm_getcsr();
#endif
      fesetround(rounding[i % 4]);
#if defined(__SSE__) || defined(_M_X64)
      if (i >= 4) _mm_setcsr(_mm_getcsr() | 0x8040u); /* FTZ, DAZ */
#endif
      m = dn_model_load(file, size, NULL, NULL, &e);
      CHECK(m && tiny_deform(m, &t, out, NULL, NULL, &e) == DN_OK);
      CHECK_MSG(halves_hash() == hash, "mode %lu changes how numbers are read", (unsigned long)i);
#if defined(__SSE__) || defined(_M_X64)
      _mm_setcsr(csr);
#endif
      fesetround(FE_TONEAREST);
      if (!m) continue;
      dn_model_describe(m, &info);
      CHECK(info.unit == 1.0f);
      for (k = 0; k < TUBE_V * 3; k++) bad += !(fabs((double)out[k] - (double)expected[k]) <= 1e-5 + 1e-4 * fabs((double)expected[k]));
      CHECK_MSG(bad == 0, "mode %lu: %lu numbers leave the tolerance", (unsigned long)i, (unsigned long)bad);
      dn_model_free(m);
   }
   for (i = 0; i < 6; i++) { /* deformnet.unit, the one decimal number of a file */
      static const char *const units[6] = {"0.01", "1e-2", "2.54E-2", "100", "0.5", "1.25e+1"};
      static const float values[6] = {0.01f, 0.01f, 0.0254f, 100.0f, 0.5f, 12.5f};
      char *text = (char *)test_block(size + 64), *at;
      unsigned char *other;
      size_t header = (size_t)file[0] | (size_t)file[1] << 8, n;
      dn_model_info info;
      memcpy(text, file + 8, header);
      text[header] = 0;
      at = strstr(text, "\"deformnet.unit\":\"1\"") + 18;
      memmove(at + strlen(units[i]), at + 1, strlen(at + 1) + 1);
      memcpy(at, units[i], strlen(units[i]));
      other = tiny_join(text, 0, file + 8 + header, size - 8 - header, &n);
      m = dn_model_load(other, n, NULL, NULL, &e);
      if (CHECK_MSG(m != NULL, "unit %s: %s", units[i], m ? "" : e.info)) {
         dn_model_describe(m, &info);
         CHECK_MSG(fabs((double)(info.unit - values[i])) <= 1e-6 * (double)values[i], "unit %s is read as %g", units[i], (double)info.unit);
      }
      dn_model_free(m);
      free(other);
      free(text);
   }
   setlocale(LC_ALL, "C");
   free(file);
   AT_LEAST(modes, 8, "modes");
}

/* f16 by its definition, in double: sign 2^(e-15) 1.m, or 2^-14 0.m */
static double half_value(unsigned h)
{
   double v = (double)(h & 1023u) / 1024.0;
   int e = (int)(h >> 10 & 31u);
   v = e ? ldexp(1.0 + v, e - 15) : ldexp(v, -14);
   return h & 0x8000u ? -v : v;
}
TEST(t20_machines)
{
   size_t size, i, k, n, rows_checked = 0;
   uint64_t hash = halves_hash();
   unsigned h;
   for (h = 0; h < 65536; h++) { /* exact, by value */
      uint32_t u = dn__half_bits(h);
      float f;
      memcpy(&f, &u, 4);
      if ((h & 0x7c00u) == 0x7c00u) CHECK((u & 0x7f800000u) == 0x7f800000u && !(u & 0x7fffffu) == !(h & 1023u) && u >> 31 == h >> 15);
      else CHECK((double)f >= half_value(h) && (double)f <= half_value(h) && u >> 31 == h >> 15);
   }
   CHECK_MSG(hash == HALVES_HASH, "numbers are read as %08lx%08lx on this machine", (unsigned long)(hash >> 32), (unsigned long)(hash & 0xffffffffu));
   CHECK(dn_kernel_name(DN_KERNEL_AUTO) && dn_kernel_name(DN_KERNEL_AUTO)[0]);
   { /* a network evaluated here in double from its file: whatever the machine, its arithmetic, its char */
      unsigned char *file = tiny_mlp(&size);
      dn_error e;
      tube t;
      dn_model *m = dn_model_load(file, size, NULL, NULL, &e);
      dn_rig *rig;
      dn_tensors *view = NULL;
      void *memory, *scratch;
      size_t bytes;
      float w[12][32], rows[TUBE_V * 6];
      static const char *const names[12] = {"input.mean", "input.std", "pre.0.weight", "pre.0.bias", "pre.0.bn.weight", "pre.0.bn.bias",
         "pre.0.bn.running_mean", "pre.0.bn.running_var", "out.weight", "out.bias", "output.std", "output.mean"};
      dn_pose pose;
      tube_make(&t);
      CHECK(dn_tensors_size(file, size, &bytes, NULL) == DN_OK);
      memory = test_aligned(bytes);
      if (!CHECK(m && dn_tensors_open(file, size, memory, bytes, &view, NULL) == DN_OK)) return;
      for (i = 0; i < 12; i++) {
         const dn_tensor *x = dn_tensors_find(view, names[i]);
         if (!CHECK(x && x->count <= 32)) return;
         dn_tensor_floats(x, 0, x->count, w[i]);
      }
      rig = dn_rig_create(m, &t.desc, NULL, NULL, &e);
      if (!CHECK_MSG(rig != NULL, "%s", rig ? "" : e.info)) return;
      bytes = dn_scratch_size(rig, 1);
      scratch = test_aligned(bytes);
      memset(&pose, 0, sizeof pose);
      pose.palette = t.palette, pose.strength = 1.0f;
      CHECK(dn_stage_skin(rig, &pose, scratch, bytes, NULL, &e) == DN_OK);
      dn_stage_rows(rig, scratch, NULL);
      dn_rows(rig, scratch, rows);
      dn_stage_network(rig, scratch, NULL, NULL);
      for (n = 0; n < TUBE_V; n++) {
         double x[6], y[5];
         for (k = 0; k < 6; k++) x[k] = ((double)rows[6 * n + k] - (double)w[0][k]) / (double)w[1][k];
         for (i = 0; i < 5; i++) {
            double s = (double)w[3][i];
            for (k = 0; k < 6; k++) s += (double)w[2][6 * i + k] * x[k];
            y[i] = tanh((s - (double)w[6][i]) / sqrt((double)w[7][i] + 1e-5) * (double)w[4][i] + (double)w[5][i]);
         }
         for (i = 0; i < 3; i++, rows_checked++) { /* root frame: joint 0 is not turned in the tube's pose */
            double s = (double)w[9][i], got = (double)dn_scratch_displacement(rig, scratch)[3 * n + i];
            for (k = 0; k < 5; k++) s += (double)w[8][5 * i + k] * y[k];
            s = s * (double)w[10][i] + (double)w[11][i];
            CHECK_MSG(fabs(got - s) <= 1e-5 + 1e-4 * fabs(s), "node %lu: %g, expected %g", (unsigned long)n, got, s);
         }
      }
      test_aligned_free(scratch);
      test_aligned_free(memory);
      dn_rig_free(rig);
      dn_model_free(m);
      free(file);
   }
   AT_LEAST(rows_checked, 126, "numbers");
}

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(t01_header_length);
   RUN(t02_not_a_header);
   RUN(t03_duplicate_keys);
   RUN(t04_data_layout);
   RUN(t05_number_syntax);
   RUN(t06_shape_products);
   RUN(t07_type_times_shape_is_range);
   RUN(t08_element_types);
   RUN(t09_rounding_and_products_wrap);
   RUN(t10_depth_and_time);
   RUN(t11_wrong_kinds_of_value);
   RUN(t12_every_prefix_and_every_flipped_byte);
   RUN(t13_odd_addresses);
   RUN(t14_weights_that_are_not_numbers);
   RUN(t15_allocations_that_fail);
   RUN(options_of_loading);
   RUN(t15_scratch_under_a_weld_distance);
   RUN(t16_declared_sizes);
   RUN(t17_meshes);
   RUN(t18_palettes);
   RUN(t19_locale_and_floating_point_modes);
   RUN(t20_machines);
   return TEST_END();
}
