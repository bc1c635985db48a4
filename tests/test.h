/*  test.h - the little that the tests share

    TEST(name) { CHECK(...); AT_LEAST(1000, "prefixes"); }
    int main(int argc, char **argv) { TEST_BEGIN(argc, argv); RUN(name); return TEST_END(); }

    A test that checks nothing fails, one that counts fewer cases than it claims fails, and a TEST without its RUN is
    an unused function, which the Makefile's -Werror refuses. A word on the command line runs the tests whose names
    contain it. */
#ifndef DN_TEST_H
#define DN_TEST_H
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static struct {
   const char *name, *filter;
   size_t checks, failed;               /* of the test that runs */
   size_t counted;                      /* AT_LEAST's text has been printed */
   size_t tests, all_checks, all_failed; /* of the program */
   char note[512];
} test_state;

#if defined(__GNUC__) || defined(__clang__)
   #define TEST_UNUSED __attribute__((unused))
   #define TEST_PRINTF(a, b) __attribute__((format(printf, a, b)))
#else
   #define TEST_UNUSED
   #define TEST_PRINTF(a, b)
#endif

#define TEST(name) static void name(void)
#define CHECK(x) test_check(!!(x), __FILE__, __LINE__, "%s", #x)
#define CHECK_MSG(x, ...) test_check(!!(x), __FILE__, __LINE__, __VA_ARGS__)
#define AT_LEAST(count, least, what) test_at_least((size_t)(count), (size_t)(least), what, __FILE__, __LINE__)
#define RUN(name) test_run(#name, name)
#define TEST_BEGIN(argc, argv) (test_state.filter = (argc) > 1 ? (argv)[1] : NULL)
#define TEST_END() test_end()

TEST_UNUSED TEST_PRINTF(4, 5) static int test_check(int ok, const char *file, int line, const char *format, ...)
{
   test_state.checks++;
   if (!ok && ++test_state.failed <= 8) {
      va_list list;
      va_start(list, format);
      printf("%s:%d: %s: ", file, line, test_state.name ? test_state.name : "?");
      vprintf(format, list);
      printf("\n");
      va_end(list);
   }
   return ok;
}
/* says how much a test looked at, and fails it when that is implausibly little */
TEST_UNUSED static void test_at_least(size_t count, size_t least, const char *what, const char *file, int line)
{
   size_t used = strlen(test_state.note);
   snprintf(test_state.note + used, sizeof test_state.note - used, ", %lu %s", (unsigned long)count, what);
   test_check(count >= least, file, line, "only %lu %s, expected at least %lu", (unsigned long)count, what,
              (unsigned long)least);
}
TEST_UNUSED static void test_run(const char *name, void (*fn)(void))
{
   clock_t start = clock();
   if (test_state.filter && !strstr(name, test_state.filter)) return;
   test_state.name = name;
   test_state.checks = test_state.failed = 0;
   test_state.note[0] = 0;
   fn();
   if (test_state.checks == 0) test_check(0, __FILE__, __LINE__, "checked nothing");
   printf("%s %s: %lu checks%s", test_state.failed ? "FAIL" : "ok  ", name, (unsigned long)test_state.checks, test_state.note);
   if (test_state.failed) printf(", %lu FAILED", (unsigned long)test_state.failed);
   printf(" (%.2f s)\n", (double)(clock() - start) / CLOCKS_PER_SEC);
   fflush(stdout);
   test_state.tests++;
   test_state.all_checks += test_state.checks;
   test_state.all_failed += test_state.failed;
}
TEST_UNUSED static int test_end(void)
{
   printf("%lu tests, %lu checks, %lu failed\n", (unsigned long)test_state.tests, (unsigned long)test_state.all_checks,
          (unsigned long)test_state.all_failed);
   return test_state.tests == 0 || test_state.all_failed != 0;
}

/* a block of exactly this size, so that a sanitizer guards its end; never NULL */
TEST_UNUSED static void *test_block(size_t size)
{
   void *p = malloc(size ? size : 1);
   if (!p) {
      fprintf(stderr, "tests: out of memory (%lu bytes)\n", (unsigned long)size);
      exit(2);
   }
   return p;
}
TEST_UNUSED static unsigned char *test_copy(const void *from, size_t size)
{
   unsigned char *p = (unsigned char *)test_block(size);
   if (size) memcpy(p, from, size);
   return p;
}
/* the whole file; exits when it is not there, for a test without its data must not pass */
TEST_UNUSED static unsigned char *test_file(const char *path, size_t *size)
{
   FILE *f = fopen(path, "rb");
   unsigned char *p = NULL;
   long n = -1;
   if (f && fseek(f, 0, SEEK_END) == 0 && (n = ftell(f)) >= 0 && fseek(f, 0, SEEK_SET) == 0) {
      p = (unsigned char *)test_block((size_t)n);
      if (fread(p, 1, (size_t)n, f) != (size_t)n) n = -1;
   }
   if (f) fclose(f);
   if (n < 0) {
      fprintf(stderr, "tests: cannot read %s\n", path);
      exit(2);
   }
   *size = (size_t)n;
   return p;
}
/* 64-byte aligned; free with test_aligned_free */
TEST_UNUSED static void *test_aligned(size_t size)
{
   unsigned char *raw = (unsigned char *)test_block(size + 64 + sizeof(void *)), *p = raw + sizeof(void *);
   p += (64 - ((size_t)(uintptr_t)p & 63)) & 63;
   memcpy(p - sizeof(void *), &raw, sizeof(void *));
   return p;
}
TEST_UNUSED static void test_aligned_free(void *p)
{
   void *raw;
   if (!p) return;
   memcpy(&raw, (unsigned char *)p - sizeof(void *), sizeof(void *));
   free(raw);
}

/* the same numbers on every machine */
TEST_UNUSED static uint32_t test_random(uint64_t *state)
{
   *state = *state * 6364136223846793005u + 1442695040888963407u;
   return (uint32_t)(*state >> 33) ^ (uint32_t)(*state >> 20);
}
TEST_UNUSED static float test_uniform(uint64_t *state, float low, float high)
{
   volatile float x = (high - low) * ((float)(test_random(state) & 0xffffffu) * (1.0f / 16777216.0f));
   return low + x; /* in two steps: a compiler may otherwise round only once, where the processor can */
}
TEST_UNUSED static uint64_t test_hash(uint64_t h, const void *data, size_t size)
{
   const unsigned char *p = (const unsigned char *)data;
   size_t i;
   for (i = 0; i < size; i++) h = (h ^ p[i]) * 1099511628211u;
   return h;
}
/* by its bits: compilers that assume finite numbers cannot optimise this away */
TEST_UNUSED static int test_finite(float x)
{
   uint32_t u;
   memcpy(&u, &x, 4);
   return (u & 0x7f800000u) != 0x7f800000u;
}
#endif
