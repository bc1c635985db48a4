/*  common.c - the examples' own parts: the PNG writer read back, the rasteriser, the thread pool's contract */
#define _POSIX_C_SOURCE 200809L
#include "../examples/common/picture.c"
#include "../examples/common/pool.c"
#include "test.h"
#include <unistd.h>

static uint32_t random_state = 12345;
static uint32_t random_word(void)
{
   random_state ^= random_state << 13;
   random_state ^= random_state >> 17;
   random_state ^= random_state << 5;
   return random_state;
}

/* ------------------------------------------------------------------ a PNG reader, apart from the writer's code */
typedef struct stream { const unsigned char *p; size_t size, bit; } stream;

static uint32_t read_bits(stream *s, unsigned count)
{
   uint32_t v = 0;
   unsigned i;
   for (i = 0; i < count; i++, s->bit++)
      if (s->bit / 8 < s->size) v |= (uint32_t)(s->p[s->bit / 8] >> (s->bit % 8) & 1) << i;
   return v;
}
static uint32_t read_code(stream *s, unsigned count)
{
   uint32_t v = 0;
   while (count--) v = v << 1 | read_bits(s, 1);
   return v;
}
static unsigned read_symbol(stream *s) /* the fixed code, by the table of RFC 1951 3.2.6 */
{
   uint32_t c = read_code(s, 7);
   if (c < 24) return 256 + c;
   c = c << 1 | read_bits(s, 1);
   if (c >= 48 && c < 192) return c - 48;
   if (c >= 192 && c < 200) return 280 + c - 192;
   c = c << 1 | read_bits(s, 1);
   return 144 + c - 400;
}
/* bytes of a zlib stream of one fixed-code block; 0 when it is anything else or does not fill out exactly */
static size_t inflate(const unsigned char *data, size_t size, unsigned char *out, size_t room)
{
   static const unsigned length_base[29] = { 3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 15, 17, 19, 23, 27, 31, 35, 43, 51, 59, 67, 83, 99, 115, 131, 163, 195, 227, 258 };
   static const unsigned length_extra[29] = { 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0 };
   static const unsigned far_base[30] = { 1, 2, 3, 4, 5, 7, 9, 13, 17, 25, 33, 49, 65, 97, 129, 193, 257, 385, 513, 769, 1025, 1537, 2049, 3073, 4097, 6145, 8193, 12289, 16385, 24577 };
   stream s;
   size_t n = 0, i;
   uint32_t a = 1, b = 0;
   s.p = data + 2, s.size = size - 2, s.bit = 0;
   if (size < 8 || (data[0] * 256 + data[1]) % 31 || (data[0] & 15) != 8 || data[1] & 32) return 0;
   if (read_bits(&s, 1) != 1 || read_bits(&s, 2) != 1) return 0;
   for (;;) {
      unsigned c = read_symbol(&s);
      if (s.bit / 8 >= s.size) return 0;
      if (c == 256) break;
      if (c < 256) {
         if (n == room) return 0;
         out[n++] = (unsigned char)c;
      } else {
         unsigned length, distance, code;
         if (c > 285) return 0;
         length = length_base[c - 257] + read_bits(&s, length_extra[c - 257]);
         code = read_code(&s, 5);
         if (code > 29) return 0;
         distance = far_base[code] + read_bits(&s, code < 4 ? 0 : code / 2 - 1);
         if (distance > n || distance > 32768 || length > room - n) return 0;
         for (; length; length--, n++) out[n] = out[n - distance];
      }
   }
   for (i = 0; i < n; i++) a = (a + out[i]) % 65521, b = (b + a) % 65521;
   s.bit = (s.bit + 7) / 8 * 8;
   for (i = 0; i < 4; i++)
      if (read_bits(&s, 8) != ((b << 16 | a) >> (24 - 8 * i) & 255)) return 0;
   return s.bit / 8 == s.size ? n : 0;
}
static uint32_t word_at(const unsigned char *p) { return (uint32_t)p[0] << 24 | (uint32_t)p[1] << 16 | (uint32_t)p[2] << 8 | p[3]; }
static uint32_t crc_of(const unsigned char *p, size_t n)
{
   uint32_t c = ~0u;
   size_t i;
   int k;
   for (i = 0; i < n; i++)
      for (c ^= p[i], k = 0; k < 8; k++) c = c & 1 ? 0xedb88320u ^ c >> 1 : c >> 1;
   return ~c;
}
/* 0 when the file is a PNG of 8-bit RGB; image->rgb is malloc'd */
static int read_png(const char *path, ex_image *image)
{
   FILE *f = fopen(path, "rb");
   unsigned char *file = (unsigned char *)malloc(1 << 24), *raw = NULL;
   size_t size = f && file ? fread(file, 1, 1 << 24, f) : 0, at = 8, line, x, y, chunks = 0;
   int bad = size < 8 || memcmp(file, "\x89PNG\r\n\x1a\n", 8) != 0;
   memset(image, 0, sizeof *image);
   if (f) fclose(f);
   while (!bad && at + 12 <= size) {
      uint32_t n = word_at(file + at);
      const unsigned char *data = file + at + 8;
      bad = n > size - at - 12 || crc_of(data - 4, n + 4) != word_at(data + n);
      if (bad) break;
      if (chunks == 0) {
         bad = memcmp(data - 4, "IHDR", 4) != 0 || n != 13 || memcmp(data + 8, "\x08\x02\0\0\0", 5) != 0;
         image->width = word_at(data), image->height = word_at(data + 4);
      } else if (memcmp(data - 4, "IDAT", 4) == 0) {
         line = image->width * 3 + 1;
         raw = (unsigned char *)malloc(line * image->height + 1);
         image->rgb = (unsigned char *)malloc(line * image->height + 1);
         bad = !raw || !image->rgb || inflate(data, n, raw, line * image->height) != line * image->height;
         for (y = 0; !bad && y < image->height; y++)
            for (x = 0; x + 1 < line; x++) {
               unsigned char *row = image->rgb + y * (line - 1);
               int left = x >= 3 ? row[x - 3] : 0, up = y ? *(row + x - (line - 1)) : 0;
               int corner = x >= 3 && y ? *(row + x - 3 - (line - 1)) : 0, guess = 0, p = left + up - corner;
               switch (raw[y * line]) {
               case 0: break;
               case 1: guess = left; break;
               case 2: guess = up; break;
               case 3: guess = (left + up) / 2; break;
               case 4:
                  guess = abs(p - left) <= abs(p - up) && abs(p - left) <= abs(p - corner) ? left
                        : abs(p - up) <= abs(p - corner)                                   ? up
                                                                                           : corner;
                  break;
               default: bad = 1;
               }
               row[x] = (unsigned char)((raw[y * line + x + 1] + guess) & 255);
            }
         free(raw);
      } else bad = memcmp(data - 4, "IEND", 4) != 0 || n != 0;
      chunks++, at += n + 12;
   }
   free(file);
   if (!bad && at == size && chunks == 3) return 0;
   ex_image_free(image);
   return 1;
}

static const char *scratch_file(void)
{
   static char path[256];
   const char *folder = getenv("TMPDIR");
   snprintf(path, sizeof path, "%s/deformnet-test-%ld.png", folder ? folder : "/tmp", (long)getpid());
   return path;
}

TEST(png_files_read_back_to_the_same_pixels)
{
   size_t images = 0, bytes = 0;
   int i;
   for (i = 0; i < 60; i++) {
      size_t w = 1 + random_word() % (i < 50 ? 60 : 400), h = 1 + random_word() % (i < 50 ? 40 : 300), k;
      ex_image im, back;
      CHECK(ex_image_create(&im, w, h, random_word() & 0xffffff) == 0);
      for (k = 0; k < w * h * 3; k++) { /* one colour, noise, ramps, noise that repeats at many distances, a tartan (for Paeth) */
         if (i % 5 == 1) im.rgb[k] = (unsigned char)random_word();
         if (i % 5 == 2) im.rgb[k] = (unsigned char)(k % (w * 3) / 2 + k / (w * 3));
         if (i % 5 == 3) im.rgb[k] = k < 97u * (unsigned)i || random_word() % 40 == 0 ? (unsigned char)random_word() : im.rgb[k - 97u * (unsigned)i];
         if (i % 5 == 4) im.rgb[k] = (unsigned char)(k % (w * 3) / 27 * 7 % 4 * 9 + k / (w * 3) / 7 * 5 % 4 * 9);
      }
      CHECK(ex_png_write(scratch_file(), &im) == NULL);
      if (CHECK_MSG(read_png(scratch_file(), &back) == 0, "image %d, %lu x %lu: not a PNG file", i, (unsigned long)w, (unsigned long)h)) {
         CHECK(back.width == w && back.height == h && memcmp(back.rgb, im.rgb, w * h * 3) == 0);
         images++, bytes += w * h * 3;
         ex_image_free(&back);
      }
      ex_image_free(&im);
   }
   remove(scratch_file());
   AT_LEAST(images, 60, "images");
   AT_LEAST(bytes, 500000, "bytes");
   {
      ex_image none;
      memset(&none, 0, sizeof none);
      CHECK(ex_png_write("/no/such/folder/x.png", &none) != NULL);
   }
}

/* a ball in two columns: grey without values, coloured with */
TEST(comparisons_show_the_value_and_only_the_value)
{
   enum { RINGS = 24, SIDES = 32, V = RINGS * SIDES };
   static float p[V * 3], value[V];
   static uint32_t triangle[(RINGS - 1) * SIDES * 2 * 3];
   size_t v, t = 0, x, y, grey[2] = { 0, 0 }, coloured[2] = { 0, 0 };
   ex_shape shape[2];
   ex_comparison c;
   ex_image im;
   for (v = 0; v < V; v++) {
      float a = 3.1415927f * ((float)(v / SIDES) + 0.5f) / RINGS, b = 6.2831853f * (float)(v % SIDES) / SIDES;
      p[3 * v] = sinf(a) * cosf(b), p[3 * v + 1] = cosf(a), p[3 * v + 2] = sinf(a) * sinf(b);
      value[v] = p[3 * v] > 0.3f ? 0.05f : 0;
   }
   for (v = 0; v + SIDES < V; v++) {
      uint32_t a = (uint32_t)v, b = (uint32_t)(v / SIDES * SIDES + (v + 1) % SIDES);
      uint32_t corner[6];
      corner[0] = a, corner[1] = b, corner[2] = a + SIDES, corner[3] = b, corner[4] = b + SIDES, corner[5] = a + SIDES;
      memcpy(triangle + t, corner, sizeof corner);
      t += 6;
   }
   memset(&c, 0, sizeof c);
   memset(shape, 0, sizeof shape);
   shape[0].title = "plain", shape[1].title = "valued";
   shape[0].positions = shape[0].normals = shape[1].positions = shape[1].normals = p;
   shape[1].value = value;
   c.title = "a ball", c.scale_title = "value";
   c.vertices = V, c.triangles = t / 3, c.triangle = triangle, c.shapes = 2, c.shape = shape, c.looked_at = 1;
   CHECK(ex_compare(scratch_file(), &c) == NULL);
   if (!CHECK(read_png(scratch_file(), &im) == 0)) return;
   for (y = 140; y + 100 < im.height; y++)
      for (x = 0; x < im.width; x++) {
         const unsigned char *q = im.rgb + 3 * (y * im.width + x);
         int most = q[0] > q[1] ? q[0] : q[1], least = q[0] < q[1] ? q[0] : q[1];
         if (q[2] > most) most = q[2];
         if (q[2] < least) least = q[2];
         if (most < 205) { /* the panels are lighter */
            if (most - least > 40) coloured[x >= im.width / 2]++;
            else grey[x >= im.width / 2]++;
         }
      }
   CHECK_MSG(coloured[0] == 0, "%lu coloured pixels without a value", (unsigned long)coloured[0]);
   AT_LEAST(grey[0], 100000, "grey pixels on the left");
   AT_LEAST(coloured[1], 50000, "coloured ones on the right");
   ex_image_free(&im);
   remove(scratch_file());
}

/* every index once, ranges cut on grain, no two at once with one worker number */
typedef struct cover { unsigned char *hit; int inside[8], slow; size_t grain, count, wrong; } cover;
static void cover_range(void *job, size_t begin, size_t end, unsigned worker)
{
   cover *c = (cover *)job;
   size_t i;
   if (worker >= 8 || begin % c->grain || (end % c->grain && end != c->count) || end <= begin || end > c->count ||
       __atomic_fetch_add(&c->inside[worker], 1, __ATOMIC_ACQ_REL)) {
      __atomic_fetch_add(&c->wrong, 1, __ATOMIC_ACQ_REL);
      return;
   }
   if (c->slow) { /* so that several take part, and the caller must wait for the last one */
      struct timespec t;
      t.tv_sec = 0, t.tv_nsec = worker ? 300000 : 100000;
      nanosleep(&t, NULL);
   }
   for (i = begin; i < end; i++) c->hit[i]++;
   __atomic_fetch_sub(&c->inside[worker], 1, __ATOMIC_ACQ_REL);
}
TEST(the_pool_keeps_the_contract_of_dn_parallel)
{
   enum { MOST = 5000 };
   static unsigned char hit[MOST];
   unsigned threads;
   size_t jobs = 0, i;
   for (threads = 1; threads <= 5; threads++) {
      ex_pool *pool = ex_pool_create(threads);
      dn_parallel par = ex_pool_parallel(pool);
      int k;
      if (!CHECK(pool != NULL)) return;
      CHECK(par.workers == threads);
      for (k = 0; k < 300; k++) {
         cover c;
         memset(&c, 0, sizeof c);
         c.hit = hit;
         c.slow = k % 10 == 0;
         c.grain = 1 + random_word() % 64;
         c.count = 1 + random_word() % (k % 3 ? 200 : MOST);
         memset(hit, 0, sizeof hit);
         par.run(par.user, c.count, c.grain, cover_range, &c);
         for (i = 0; i < MOST; i++) c.wrong += hit[i] != (i < c.count);
         CHECK(c.wrong == 0);
         jobs++;
      }
      ex_pool_free(pool);
   }
   CHECK(ex_pool_parallel(NULL).run == NULL);
   AT_LEAST(jobs, 1500, "jobs");
}

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(png_files_read_back_to_the_same_pixels);
   RUN(comparisons_show_the_value_and_only_the_value);
   RUN(the_pool_keeps_the_contract_of_dn_parallel);
   return TEST_END();
}
