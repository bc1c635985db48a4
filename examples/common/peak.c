/* peak.c - see peak.h */
#include "peak.h"
#include "tool.h"
#if defined(__GNUC__) && defined(__x86_64__)
   #define EX_X86
   #include <immintrin.h>
#elif defined(__aarch64__)
   #include <arm_neon.h>
#endif

/* 14 sums hide the latency of an instruction */
enum { PEAK_STEPS = 200000 };
#define EACH14(X) X(0) X(1) X(2) X(3) X(4) X(5) X(6) X(7) X(8) X(9) X(10) X(11) X(12) X(13)
#ifdef EX_X86
__attribute__((target("avx512f"))) static float peak_avx512(float a, float b)
{
   const __m512 x = _mm512_set1_ps(a), y = _mm512_set1_ps(b);
   float out[16];
   size_t i;
   #define START(k) __m512 s##k = _mm512_set1_ps((float)k);
   #define STEP(k) s##k = _mm512_fmadd_ps(s##k, x, y);
   #define SUM(k) s0 = _mm512_add_ps(s0, s##k);
   EACH14(START)
   for (i = 0; i < PEAK_STEPS; i++) {
      EACH14(STEP)
   }
   EACH14(SUM)
   #undef START
   #undef STEP
   #undef SUM
   _mm512_storeu_ps(out, s0);
   return out[0];
}
__attribute__((target("avx2,fma"))) static float peak_avx2(float a, float b)
{
   const __m256 x = _mm256_set1_ps(a), y = _mm256_set1_ps(b);
   float out[8];
   size_t i;
   #define START(k) __m256 s##k = _mm256_set1_ps((float)k);
   #define STEP(k) s##k = _mm256_fmadd_ps(s##k, x, y);
   #define SUM(k) s0 = _mm256_add_ps(s0, s##k);
   EACH14(START)
   for (i = 0; i < PEAK_STEPS; i++) {
      EACH14(STEP)
   }
   EACH14(SUM)
   #undef START
   #undef STEP
   #undef SUM
   _mm256_storeu_ps(out, s0);
   return out[0];
}
static float peak_sse(float a, float b)
{
   const __m128 x = _mm_set1_ps(a), y = _mm_set1_ps(b);
   float out[4];
   size_t i;
   #define START(k) __m128 s##k = _mm_set1_ps((float)k);
   #define STEP(k) s##k = _mm_add_ps(_mm_mul_ps(s##k, x), y);
   #define SUM(k) s0 = _mm_add_ps(s0, s##k);
   EACH14(START)
   for (i = 0; i < PEAK_STEPS; i++) {
      EACH14(STEP)
   }
   EACH14(SUM)
   #undef START
   #undef STEP
   #undef SUM
   _mm_storeu_ps(out, s0);
   return out[0];
}
__attribute__((target("avx512f,avx512bf16"))) static float peak_bf16(float a, float b)
{
   const __m512bh x = (__m512bh)_mm512_castps_si512(_mm512_set1_ps(a)), y = (__m512bh)_mm512_castps_si512(_mm512_set1_ps(b));
   float out[16];
   #define START(k) __m512 s##k = _mm512_set1_ps((float)k);
   #define STEP(k) s##k = _mm512_dpbf16_ps(s##k, x, y);
   #define SUM(k) s0 = _mm512_add_ps(s0, s##k);
   size_t i;
   EACH14(START)
   for (i = 0; i < PEAK_STEPS; i++) {
      EACH14(STEP)
   }
   EACH14(SUM)
   #undef START
   #undef STEP
   #undef SUM
   _mm512_storeu_ps(out, s0);
   return out[0];
}
__attribute__((target("avx512f,avx512vnni"))) static float peak_vnni(float a, float b)
{
   const __m512i x = _mm512_castps_si512(_mm512_set1_ps(a)), y = _mm512_castps_si512(_mm512_set1_ps(b));
   int out[16];
   size_t i;
   #define START(k) __m512i s##k = _mm512_set1_epi32(k);
   #define STEP(k) s##k = _mm512_dpbusd_epi32(s##k, x, y);
   #define SUM(k) s0 = _mm512_add_epi32(s0, s##k);
   EACH14(START)
   for (i = 0; i < PEAK_STEPS; i++) {
      EACH14(STEP)
   }
   EACH14(SUM)
   #undef START
   #undef STEP
   #undef SUM
   _mm512_storeu_si512(out, s0);
   return (float)out[0];
}
__attribute__((target("avx2"))) static float peak_maddubs(float a, float b)
{
   const __m256i x = _mm256_castps_si256(_mm256_set1_ps(a)), one = _mm256_set1_epi16(1);
   __m256i y = _mm256_castps_si256(_mm256_set1_ps(b));
   int out[8];
   size_t i;
   #define START(k) __m256i s##k = _mm256_set1_epi32(k);
   /* the empty text says that y may have changed: else the product would leave the loop */
   #define STEP(k) __asm__ volatile("" : "+x"(y)); s##k = _mm256_add_epi32(s##k, _mm256_madd_epi16(_mm256_maddubs_epi16(x, y), one));
   #define SUM(k) s0 = _mm256_add_epi32(s0, s##k);
   EACH14(START)
   for (i = 0; i < PEAK_STEPS; i++) {
      EACH14(STEP)
   }
   EACH14(SUM)
   #undef START
   #undef STEP
   #undef SUM
   _mm256_storeu_si256((__m256i *)(void *)out, s0);
   return (float)out[0];
}
#endif
#if defined(__aarch64__)
static float peak_neon(float a, float b)
{
   const float32x4_t x = vdupq_n_f32(a), y = vdupq_n_f32(b);
   size_t i;
   #define START(k) float32x4_t s##k = vdupq_n_f32((float)k);
   #define STEP(k) s##k = vfmaq_f32(y, s##k, x);
   #define SUM(k) s0 = vaddq_f32(s0, s##k);
   EACH14(START)
   for (i = 0; i < PEAK_STEPS; i++) {
      EACH14(STEP)
   }
   EACH14(SUM)
   #undef START
   #undef STEP
   #undef SUM
   return vgetq_lane_f32(s0, 0);
}
#endif
static float peak_plain(float a, float b)
{
   size_t i;
   #define START(k) float s##k = (float)k;
   #define STEP(k) s##k = s##k * a + b;
   #define SUM(k) s0 += s##k;
   EACH14(START)
   for (i = 0; i < PEAK_STEPS; i++) {
      EACH14(STEP)
   }
   EACH14(SUM)
   #undef START
   #undef STEP
   #undef SUM
   return s0;
}

typedef float peak_loop(float a, float b);
typedef struct peak_text { peak_loop *loop; double operations; } peak_text; /* of one step of one sum */

static peak_text text_of(ex_peak_kind kind, dn_kernel kernel)
{
   peak_text t = { peak_plain, 2 };
   (void)kind, (void)kernel;
#ifdef EX_X86
   if (kernel == DN_KERNEL_AVX512) t.loop = peak_avx512, t.operations = 32;
   if (kernel == DN_KERNEL_AVX2) t.loop = peak_avx2, t.operations = 16;
   if (kernel == DN_KERNEL_SSE) t.loop = peak_sse, t.operations = 8;
   if (kind == EX_PEAK_BF16 && kernel == DN_KERNEL_AVX512 && __builtin_cpu_supports("avx512bf16")) t.loop = peak_bf16, t.operations = 64;
   if (kind == EX_PEAK_INT8 && kernel == DN_KERNEL_AVX512 && __builtin_cpu_supports("avx512vnni")) t.loop = peak_vnni, t.operations = 128;
   if (kind == EX_PEAK_INT8 && kernel == DN_KERNEL_AVX2) t.loop = peak_maddubs, t.operations = 64;
#elif defined(__aarch64__)
   if (kernel == DN_KERNEL_NEON) t.loop = peak_neon, t.operations = 8;
#endif
   return t;
}
typedef struct peak_job { peak_loop *loop; volatile float a, b, sink[256]; } peak_job;
static void peak_range(void *user, size_t begin, size_t end, unsigned worker)
{
   peak_job *j = (peak_job *)user;
   (void)worker;
   for (; begin < end; begin++) j->sink[begin % 256] = j->loop(j->a, j->b);
}
double ex_peak(ex_peak_kind kind, dn_kernel kernel, const dn_parallel *par, unsigned threads)
{
   peak_text text = text_of(kind, kernel);
   peak_job j;
   size_t items = 4 * (threads ? threads : 1);
   double start;
   j.loop = text.loop, j.a = 0.999f, j.b = 0.001f;
   start = ex_now_ms();
   if (threads > 1 && par && par->run) par->run(par->user, items, 1, peak_range, &j);
   else peak_range(&j, 0, items, 0);
   return (double)items * PEAK_STEPS * 14 * text.operations / (ex_now_ms() - start) * 1e-6;
}
