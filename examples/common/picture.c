/* picture.c - see picture.h */
#include "picture.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ===================================================================================== >>image */
int ex_image_create(ex_image *image, size_t width, size_t height, uint32_t colour)
{
   size_t i, n = width * height;
   memset(image, 0, sizeof *image);
   image->rgb = (unsigned char *)malloc(n * 3 + 1);
   if (!image->rgb) return 1;
   image->width = width;
   image->height = height;
   for (i = 0; i < n; i++) {
      image->rgb[3 * i] = (unsigned char)(colour >> 16 & 255);
      image->rgb[3 * i + 1] = (unsigned char)(colour >> 8 & 255);
      image->rgb[3 * i + 2] = (unsigned char)(colour & 255);
   }
   return 0;
}

void ex_image_free(ex_image *image)
{
   free(image->rgb);
   memset(image, 0, sizeof *image);
}

static void blend(ex_image *im, int x, int y, uint32_t colour, float a)
{
   unsigned char *p;
   int k;
   if (x < 0 || y < 0 || (size_t)x >= im->width || (size_t)y >= im->height || a <= 0) return;
   if (a > 1) a = 1;
   p = im->rgb + 3 * ((size_t)y * im->width + (size_t)x);
   for (k = 0; k < 3; k++) {
      float c = (float)(colour >> (16 - 8 * k) & 255);
      p[k] = (unsigned char)((float)p[k] + ((float)c - (float)p[k]) * a + 0.5f);
   }
}

static void fill(ex_image *im, int x0, int y0, int w, int h, uint32_t colour)
{
   int x, y;
   for (y = y0; y < y0 + h; y++)
      for (x = x0; x < x0 + w; x++) blend(im, x, y, colour, 1);
}

static void frame(ex_image *im, int x, int y, int w, int h, uint32_t colour, float a)
{
   int i;
   for (i = 0; i < w; i++) blend(im, x + i, y, colour, a), blend(im, x + i, y + h - 1, colour, a);
   for (i = 1; i < h - 1; i++) blend(im, x, y + i, colour, a), blend(im, x + w - 1, y + i, colour, a);
}

/* ===================================================================================== >>png
   zlib with the fixed Huffman code of RFC 1951 and greedy matches: half the size of stored blocks or less */
typedef struct bits {
   unsigned char *out;
   size_t used;
   uint32_t hold;
   unsigned count;
} bits;

static void put_bits(bits *b, uint32_t value, unsigned count) /* least significant bit first; count <= 16 */
{
   b->hold |= value << b->count;
   b->count += count;
   while (b->count >= 8) {
      b->out[b->used++] = (unsigned char)(b->hold & 255);
      b->hold >>= 8;
      b->count -= 8;
   }
}
static void put_code(bits *b, uint32_t code, unsigned count) /* Huffman codes go most significant bit first */
{
   uint32_t reversed = 0;
   unsigned i;
   for (i = 0; i < count; i++) reversed |= (code >> i & 1) << (count - 1 - i);
   put_bits(b, reversed, count);
}
static void put_symbol(bits *b, unsigned s) /* RFC 1951, 3.2.6 */
{
   if (s < 144) put_code(b, 0x30 + s, 8);
   else if (s < 256) put_code(b, 0x190 + s - 144, 9);
   else if (s < 280) put_code(b, s - 256, 7);
   else put_code(b, 0xC0 + s - 280, 8);
}
static void put_match(bits *b, unsigned length, unsigned distance) /* 3..258, 1..32768 */
{
   unsigned extra, base, code;
   if (length == 258) put_symbol(b, 285);
   else { /* from length 11 on, four codes share each number of extra bits */
      for (extra = 0, base = 3, code = 257; length - base >= (extra ? 4u << extra : 8u); extra++) {
         base += extra ? 4u << extra : 8u;
         code += extra ? 4 : 8;
      }
      put_symbol(b, code + ((length - base) >> extra));
      put_bits(b, (length - base) & ((1u << extra) - 1), extra);
   }
   for (extra = 0, base = 1, code = 0; distance - base >= (extra ? 2u << extra : 4u); extra++) {
      base += extra ? 2u << extra : 4u;
      code += extra ? 2 : 4;
   }
   put_code(b, code + ((distance - base) >> extra), 5);
   put_bits(b, (distance - base) & ((1u << extra) - 1), extra);
}

enum { HASH_BITS = 15, WINDOW = 32768, LONGEST = 258, TRIES = 48 };
static size_t hash3(const unsigned char *p)
{
   return ((uint32_t)p[0] << 16 | (uint32_t)p[1] << 8 | p[2]) * 2654435761u >> (32 - HASH_BITS);
}

/* NULL when memory runs out; else *used bytes, the caller frees them */
static unsigned char *deflate_zlib(const unsigned char *in, size_t size, size_t *used)
{
   size_t *head = (size_t *)calloc((size_t)1 << HASH_BITS, sizeof *head); /* place + 1 */
   size_t *prev = (size_t *)calloc(WINDOW, sizeof *prev);
   bits b;
   size_t at, i;
   uint32_t s1 = 1, s2 = 0;
   memset(&b, 0, sizeof b);
   b.out = (unsigned char *)malloc(size + size / 8 + 64); /* nine bits a byte at worst */
   if (!head || !prev || !b.out) {
      free(head), free(prev), free(b.out);
      return NULL;
   }
   put_bits(&b, 0x78, 8), put_bits(&b, 0x5e, 8); /* 32 KB window; check bits make it divisible by 31 */
   put_bits(&b, 1, 1), put_bits(&b, 1, 2);       /* one block, fixed code */
   for (at = 0; at < size;) {
      size_t best = 0, from = 0, limit = size - at, step;
      if (limit > LONGEST) limit = LONGEST;
      if (limit >= 3) {
         size_t c = head[hash3(in + at)];
         int tries;
         for (tries = 0; c && at + 1 - c <= WINDOW && tries < TRIES; tries++, c = prev[(c - 1) % WINDOW]) {
            size_t n = 0;
            while (n < limit && in[c - 1 + n] == in[at + n]) n++;
            if (n > best) best = n, from = c - 1;
            if (best == limit) break;
         }
      }
      if (best >= 3) put_match(&b, (unsigned)best, (unsigned)(at - from));
      else put_symbol(&b, in[at]);
      for (step = best >= 3 ? best : 1; step; step--, at++)
         if (size - at >= 3) {
            size_t h = hash3(in + at);
            prev[at % WINDOW] = head[h];
            head[h] = at + 1;
         }
   }
   put_symbol(&b, 256);
   if (b.count) put_bits(&b, 0, 8 - b.count);
   for (i = 0; i < size; i++) s1 = (s1 + in[i]) % 65521, s2 = (s2 + s1) % 65521; /* Adler-32 */
   for (i = 0; i < 4; i++) b.out[b.used++] = (unsigned char)((s2 << 16 | s1) >> (24 - 8 * i) & 255);
   free(head), free(prev);
   *used = b.used;
   return b.out;
}

static int put_chunk(FILE *f, const char *type, const unsigned char *data, size_t size)
{
   unsigned char word[4];
   uint32_t crc = 0xffffffffu;
   size_t i;
   int k;
   for (i = 0; i < size + 4; i++) {
      crc ^= i < 4 ? (unsigned char)type[i] : data[i - 4];
      for (k = 0; k < 8; k++) crc = crc >> 1 ^ (crc & 1 ? 0xedb88320u : 0);
   }
   crc = ~crc;
   for (i = 0; i < 4; i++) word[i] = (unsigned char)(size >> (24 - 8 * i) & 255);
   if (fwrite(word, 1, 4, f) != 4 || fwrite(type, 1, 4, f) != 4) return 1;
   if (size && fwrite(data, 1, size, f) != size) return 1;
   for (i = 0; i < 4; i++) word[i] = (unsigned char)(crc >> (24 - 8 * i) & 255);
   return fwrite(word, 1, 4, f) != 4;
}

static int paeth(int a, int b, int c)
{
   int p = a + b - c, pa = abs(p - a), pb = abs(p - b), pc = abs(p - c);
   return pa <= pb && pa <= pc ? a : pb <= pc ? b : c;
}
/* each row is predicted from its neighbours in the way that leaves the smallest remainders */
static void filter_rows(const ex_image *im, unsigned char *out)
{
   size_t w = im->width * 3, x, y;
   int kind;
   for (y = 0; y < im->height; y++, out += w + 1) {
      const unsigned char *row = im->rgb + y * w, *up = y ? row - w : NULL;
      unsigned long least = 0;
      int chosen = -1, pass;
      for (pass = 0; pass < 6; pass++) {
         unsigned long sum = 0;
         kind = pass < 5 ? pass : chosen;
         for (x = 0; x < w; x++) {
            int a = x >= 3 ? row[x - 3] : 0, b = up ? up[x] : 0, c = up && x >= 3 ? up[x - 3] : 0;
            int guess = kind == 0 ? 0 : kind == 1 ? a : kind == 2 ? b : kind == 3 ? (a + b) / 2 : paeth(a, b, c);
            int rest = (row[x] - guess) & 255;
            out[x + 1] = (unsigned char)rest;
            sum += (unsigned long)(rest < 128 ? rest : 256 - rest);
         }
         if (chosen < 0 || sum < least) least = sum, chosen = kind;
      }
      out[0] = (unsigned char)chosen;
   }
}

const char *ex_png_write(const char *path, const ex_image *im)
{
   static const unsigned char signature[8] = { 137, 80, 78, 71, 13, 10, 26, 10 };
   unsigned char head[13], *raw, *packed = NULL;
   size_t size = im->height * (im->width * 3 + 1), used = 0, i;
   FILE *f;
   int bad;
   raw = (unsigned char *)malloc(size ? size : 1);
   if (raw) {
      filter_rows(im, raw);
      packed = deflate_zlib(raw, size, &used);
      free(raw);
   }
   if (!packed) return "out of memory for the picture";
   for (i = 0; i < 4; i++) {
      head[i] = (unsigned char)(im->width >> (24 - 8 * i) & 255);
      head[4 + i] = (unsigned char)(im->height >> (24 - 8 * i) & 255);
   }
   head[8] = 8, head[9] = 2, head[10] = head[11] = head[12] = 0; /* 8 bits a channel, RGB */
   f = fopen(path, "wb");
   if (!f) {
      free(packed);
      return "cannot write the picture there";
   }
   bad = fwrite(signature, 1, 8, f) != 8 || put_chunk(f, "IHDR", head, 13) || put_chunk(f, "IDAT", packed, used) ||
         put_chunk(f, "IEND", NULL, 0);
   bad |= fclose(f) != 0;
   free(packed);
   return bad ? "writing the picture failed (disk full?)" : NULL;
}

/* ===================================================================================== >>font
   Strokes on a grid: x from 0, baseline y = 2, small letters to 6, capitals to 8, descenders to 0. A pair of digits
   is a point; "~" opens a quadratic spline whose inner points are controls, "o" the same closed; a blank lifts the pen. */
static const char *glyph(char c)
{
   static const char *const digit[10] = {
      "o02 42 48 08", "06 28 22", "~07 08 48 45 02 02;02 42", "~07 08 48 45 15;~15 45 42 02 03", "34 38 04 44;34 32",
      "48 08 05;~05 46 46 42 02 03", "o02 42 46 06;~04 08 48 47", "08 48 12", "o05 45 48 08;o02 42 45 05",
      "o04 44 48 08;~46 42 02 03",
   };
   static const char *const upper[26] = {
      "02 38 62;14 54", "02 08;~08 48 45 05;~05 55 52 02", "~57 58 08 02 52 53", "02 08;~08 58 52 02", "48 08 02 42;05 35",
      "48 08 02;05 35", "~57 58 08 02 52 55;55 35", "02 08;52 58;05 55", "02 08", "~38 32 02 03", "02 08;48 05 42",
      "08 02 42", "02 08 34 68 62", "02 08 52 58", "o02 52 58 08", "02 08;~08 58 54 04", "o02 52 58 08;33 52",
      "02 08;~08 58 54 04;24 52", "~47 48 08 05 45 42 02 03", "08 68;38 32", "~08 05 02 52 55 58", "08 32 68",
      "08 22 47 62 88", "02 58;08 52", "08 35 68;35 32", "08 58 02 52",
   };
   static const char *const lower[26] = {
      "o02 42 46 06;46 42", "08 02;o02 42 46 06", "~45 46 06 02 42 43", "o02 42 46 06;48 42", "04 44;~44 46 06 02 42 43",
      "~38 18 15 12;06 36", "o02 42 46 06;~46 43 40 00 01", "08 02;~04 06 46 44;44 42", "06 02;08 08", "~16 13 10 00;18 18",
      "08 02;46 04 42", "08 02", "06 02;~04 06 36 34;34 32;~34 36 66 64;64 62", "06 02;~04 06 46 44;44 42", "o02 42 46 06",
      "06 00;o02 42 46 06", "o02 42 46 06;46 40", "06 02;~04 06 26 36", "~35 36 06 04 34 32 02 03", "~18 14 12 32;06 36",
      "~06 04 02 42 44;46 42", "06 22 46", "06 12 36 52 66", "02 46;06 42", "06 22;46 10", "06 46 02 42",
   };
   if (c >= '0' && c <= '9') return digit[c - '0'];
   if (c >= 'A' && c <= 'Z') return upper[c - 'A'];
   if (c >= 'a' && c <= 'z') return lower[c - 'a'];
   switch (c) {
   case '.': return "02 02";
   case ',': return "~13 12 01";
   case ':': return "02 02;05 05";
   case '-': return "05 35";
   case '+': return "05 45;23 27";
   case '/': return "01 49";
   case '(': return "~29 07 03 21";
   case ')': return "~09 27 23 01";
   case '%': return "02 58;o06 26 28 08;o32 52 54 34";
   case '=': return "04 44;06 46";
   case '<': return "47 05 43";
   case '>': return "07 45 03";
   case '_': return "01 41";
   case '\'': return "08 06";
   case '!': return "08 04;02 02";
   default: return "";
   }
}

enum { PIECES = 160 };
typedef struct strokes {
   float piece[PIECES][4]; /* x0 y0 x1 y1 on the grid */
   int count;
   float width;
} strokes;

static void add_piece(strokes *s, float x0, float y0, float x1, float y1)
{
   float *p;
   if (s->count == PIECES) return;
   p = s->piece[s->count++];
   p[0] = x0, p[1] = y0, p[2] = x1, p[3] = y1;
}
static void add_curve(strokes *s, const float a[2], const float c[2], const float b[2])
{
   float x = a[0], y = a[1];
   int i;
   for (i = 1; i <= 6; i++) {
      float t = (float)i / 6, u = 1 - t;
      float nx = u * u * a[0] + 2 * u * t * c[0] + t * t * b[0], ny = u * u * a[1] + 2 * u * t * c[1] + t * t * b[1];
      add_piece(s, x, y, nx, ny);
      x = nx, y = ny;
   }
}
static strokes read_glyph(char ch)
{
   const char *g = glyph(ch);
   strokes s;
   memset(&s, 0, sizeof s);
   if (!*g) s.width = 2;
   while (*g) {
      float p[16][2], a[2], b[2];
      int n = 0, i, kind = *g == '~' || *g == 'o' ? *g++ : 0, pieces;
      while (*g && *g != ';') {
         if (*g == ' ') g++;
         p[n][0] = (float)(g[0] - '0'), p[n][1] = (float)(g[1] - '0');
         if (p[n][0] > s.width) s.width = p[n][0];
         n++, g += 2;
      }
      if (*g == ';') g++;
      pieces = kind == 'o' ? n : n - 1;
      for (i = kind == '~' ? 1 : 0; i < pieces; i++) {
         const float *q = p[(i + 1) % n], *r = p[(i + n - 1) % n];
         if (!kind) {
            add_piece(&s, p[i][0], p[i][1], q[0], q[1]);
            continue;
         }
         a[0] = (p[i][0] + r[0]) / 2, a[1] = (p[i][1] + r[1]) / 2;
         b[0] = (p[i][0] + q[0]) / 2, b[1] = (p[i][1] + q[1]) / 2;
         if (kind == '~' && i == 1) a[0] = r[0], a[1] = r[1];
         if (kind == '~' && i == n - 2) b[0] = q[0], b[1] = q[1];
         add_curve(&s, a, p[i], b);
      }
   }
   return s;
}

static float distance_to_piece(const float *p, float x, float y)
{
   float dx = p[2] - p[0], dy = p[3] - p[1], l = dx * dx + dy * dy;
   float t = l > 0 ? ((x - p[0]) * dx + (y - p[1]) * dy) / l : 0;
   t = t < 0 ? 0 : t > 1 ? 1 : t;
   dx = x - p[0] - t * dx, dy = y - p[1] - t * dy;
   return sqrtf(dx * dx + dy * dy);
}

static const float grid_x = 0.86f, spacing = 2.1f; /* a little narrower than high; pen-up between letters */

float ex_text_width(float size, const char *text)
{
   float w = 0;
   for (; *text; text++) {
      strokes s = read_glyph(*text);
      w += s.width * grid_x + spacing;
   }
   return w > 0 ? (w - spacing) * size / 6 : 0;
}

void ex_text(ex_image *im, float x, float y, float size, uint32_t colour, const char *text)
{
   float unit = size / 6, pen = unit * 0.42f > 0.6f ? unit * 0.42f : 0.6f; /* half the stroke's width, pixels */
   for (; *text; text++) {
      strokes s = read_glyph(*text);
      int px, py, i, x1 = (int)ceilf(x + s.width * grid_x * unit + pen + 1);
      if (s.count)
         for (py = (int)floorf(y - 7 * unit - pen - 1); py <= (int)ceilf(y + 2 * unit + pen + 1); py++)
            for (px = (int)floorf(x - pen - 1); px <= x1; px++) {
               float nearest = 1e9f;
               for (i = 0; i < s.count; i++) {
                  float q[4], d;
                  q[0] = x + s.piece[i][0] * grid_x * unit, q[1] = y - (s.piece[i][1] - 2) * unit;
                  q[2] = x + s.piece[i][2] * grid_x * unit, q[3] = y - (s.piece[i][3] - 2) * unit;
                  d = distance_to_piece(q, (float)px + 0.5f, (float)py + 0.5f);
                  if (d < nearest) nearest = d;
               }
               blend(im, px, py, colour, pen - nearest + 0.5f);
            }
      x += (s.width * grid_x + spacing) * unit;
   }
}

/* ===================================================================================== >>raster */
typedef struct camera { /* perspective; depth grows away from the eye, which is `eye` from the centre */
   float right[3], up[3], back[3], centre[3];
   float eye, scale; /* metres; pixels per metre at the centre */
} camera;

static float dot(const float *a, const float *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static camera look(float azimuth, float elevation, const float centre[3], float radius, float pixels)
{
   camera c;
   float ca = cosf(azimuth), sa = sinf(azimuth), ce = cosf(elevation), se = sinf(elevation);
   c.right[0] = ca, c.right[1] = 0, c.right[2] = -sa;
   c.up[0] = -sa * se, c.up[1] = ce, c.up[2] = -ca * se;
   c.back[0] = sa * ce, c.back[1] = se, c.back[2] = ca * ce;
   memcpy(c.centre, centre, sizeof c.centre);
   c.eye = radius * 6;
   c.scale = pixels / (2 * radius);
   return c;
}
/* pixels from the middle of the panel, and depth */
static void project(const camera *c, const float *p, float out[3])
{
   float d[3], depth;
   int k;
   for (k = 0; k < 3; k++) d[k] = p[k] - c->centre[k];
   depth = c->eye - dot(d, c->back);
   out[2] = depth;
   depth = depth > c->eye * 0.05f ? depth : c->eye * 0.05f;
   out[0] = dot(d, c->right) * c->scale * c->eye / depth;
   out[1] = -dot(d, c->up) * c->scale * c->eye / depth;
}

typedef struct sample { float depth, normal[3], value; uint32_t colour; } sample; /* depth 0: nothing there; colour 0: by value */
typedef struct buffer {
   int width, height;
   sample *at;
} buffer;

static int buffer_create(buffer *b, int width, int height)
{
   b->width = width;
   b->height = height;
   b->at = (sample *)malloc((size_t)width * (size_t)height * sizeof *b->at);
   return b->at == NULL;
}

static float edge(const float *a, const float *b, float x, float y) { return (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]); }

/* on top of what is there. screen (V,3) is scratch. Inner sides get their normals turned to the eye and a value of -1. */
static void raster_add(buffer *b, const camera *c, const ex_comparison *m, const ex_shape *s, uint32_t colour, float *screen)
{
   size_t v, t, k;
   float mx = (float)b->width / 2, my = (float)b->height / 2;
   for (v = 0; v < m->vertices; v++) {
      project(c, s->positions + 3 * v, screen + 3 * v);
      screen[3 * v] += mx, screen[3 * v + 1] += my;
   }
   for (t = 0; t < m->triangles; t++) {
      const uint32_t *id = m->triangle + 3 * t;
      const float *p0 = screen + 3 * id[0], *p1 = screen + 3 * id[1], *p2 = screen + 3 * id[2];
      float area = edge(p0, p1, p2[0], p2[1]), lo_x, hi_x, lo_y, hi_y;
      int x, y, x0, x1, y0, y1, inner = area > 0; /* y points down here, so outer sides have area < 0 */
      if (!(area < 0 || area > 0) || p0[2] < c->eye * 0.1f || p1[2] < c->eye * 0.1f || p2[2] < c->eye * 0.1f) continue;
      lo_x = fminf(p0[0], fminf(p1[0], p2[0])), hi_x = fmaxf(p0[0], fmaxf(p1[0], p2[0]));
      lo_y = fminf(p0[1], fminf(p1[1], p2[1])), hi_y = fmaxf(p0[1], fmaxf(p1[1], p2[1]));
      if (!(hi_x > 0 && hi_y > 0 && lo_x < (float)b->width && lo_y < (float)b->height)) continue;
      x0 = lo_x > 0 ? (int)lo_x : 0, x1 = hi_x < (float)(b->width - 1) ? (int)hi_x : b->width - 1;
      y0 = lo_y > 0 ? (int)lo_y : 0, y1 = hi_y < (float)(b->height - 1) ? (int)hi_y : b->height - 1;
      for (y = y0; y <= y1; y++)
         for (x = x0; x <= x1; x++) {
            float px = (float)x + 0.5f, py = (float)y + 0.5f, depth;
            float w0 = edge(p1, p2, px, py) / area, w1 = edge(p2, p0, px, py) / area, w2 = 1 - w0 - w1;
            sample *q = b->at + (size_t)y * (size_t)b->width + (size_t)x;
            if (w0 < 0 || w1 < 0 || w2 < 0) continue;
            depth = 1 / (w0 / p0[2] + w1 / p1[2] + w2 / p2[2]);
            if (q->depth > 0 && q->depth <= depth) continue;
            q->depth = depth;
            for (k = 0; k < 3; k++) {
               float n = w0 * s->normals[3 * id[0] + k] + w1 * s->normals[3 * id[1] + k] + w2 * s->normals[3 * id[2] + k];
               q->normal[k] = inner ? -n : n;
            }
            q->value = inner ? -1.0f : s->value ? w0 * s->value[id[0]] + w1 * s->value[id[1]] + w2 * s->value[id[2]] : 0;
            q->colour = colour;
         }
   }
}
static void raster_clear(buffer *b) { memset(b->at, 0, (size_t)b->width * (size_t)b->height * sizeof *b->at); }
static void raster(buffer *b, const camera *c, const ex_comparison *m, const ex_shape *s, float *screen)
{
   raster_clear(b);
   raster_add(b, c, m, s, 0, screen);
}

/* ===================================================================================== >>colour */
static float clamp01(float x) { return x < 0 ? 0 : x > 1 ? 1 : x; }

static void scale_colour(float t, float rgb[3]) /* clay, then yellow, orange, red, violet; linear light */
{
   static const float stop[6][3] = { { .60f, .58f, .55f }, { .78f, .66f, .36f }, { .90f, .50f, .10f },
                                     { .83f, .19f, .06f }, { .52f, .04f, .12f }, { .20f, .02f, .17f } };
   float f;
   int i, k;
   t = clamp01(t) * 5;
   i = t < 4 ? (int)t : 4;
   f = t - (float)i;
   for (k = 0; k < 3; k++) rgb[k] = stop[i][k] + (stop[i + 1][k] - stop[i][k]) * f;
}
static float to_srgb(float x) { return x <= 0.0031308f ? 12.92f * x : 1.055f * powf(x, 1 / 2.4f) - 0.055f; }
static float from_srgb(float x) { return x <= 0.04045f ? x / 12.92f : powf((x + 0.055f) / 1.055f, 2.4f); }
static uint32_t pack(const float rgb[3])
{
   uint32_t c = 0;
   int k;
   for (k = 0; k < 3; k++) c = c << 8 | (uint32_t)(clamp01(to_srgb(clamp01(rgb[k]))) * 255 + 0.5f);
   return c;
}

/* how much of the sky the depth buffer hides: eight directions at two reaches, turned from sample to sample */
static float openness(const buffer *b, int x, int y, float reach /* samples */, float metre /* samples per metre */)
{
   const sample *q = b->at + (size_t)y * (size_t)b->width + (size_t)x;
   uint32_t h = (uint32_t)x * 73856093u ^ (uint32_t)y * 19349663u;
   float hidden = 0, turn;
   int i;
   h = (h ^ h >> 15) * 2246822519u;
   h ^= h >> 13;
   turn = (float)(h & 1023) * (6.2831853f / 1024);
   for (i = 0; i < 16; i++) {
      float a = turn + (float)i * (6.2831853f / 8), r = reach * (i < 8 ? 0.25f + (float)(h >> 10 & 15) / 60 : 1.0f);
      int sx = x + (int)(cosf(a) * r), sy = y + (int)(sinf(a) * r);
      const sample *s;
      float rise;
      if (sx < 0 || sy < 0 || sx >= b->width || sy >= b->height) continue;
      s = b->at + (size_t)sy * (size_t)b->width + (size_t)sx;
      if (s->depth <= 0) continue;
      rise = (q->depth - s->depth) * metre / r; /* slope towards the neighbour */
      if (rise > 0.12f) hidden += clamp01((rise - 0.12f) * 0.8f) * (rise > 6 ? 6 / rise : 1); /* far in front: not its shade */
   }
   return 1 - 0.75f * clamp01(hidden / 9);
}

enum { SUPER = 3 }; /* samples along a pixel's side */
static const float panel_light[3] = { .905f, .900f, .890f };

static void shade(ex_image *im, int ox, int oy, const buffer *b, const camera *c, float top /* of the scale, metres */)
{
   float key[3], fill_light[3], rim[3];
   int x, y, i, j, k, w = b->width / SUPER, h = b->height / SUPER;
   for (k = 0; k < 3; k++) { /* the lights stand with the camera */
      key[k] = -0.50f * c->right[k] + 0.62f * c->up[k] + 0.60f * c->back[k];
      fill_light[k] = 0.80f * c->right[k] + 0.10f * c->up[k] + 0.59f * c->back[k];
      rim[k] = 0.30f * c->right[k] + 0.75f * c->up[k] - 0.59f * c->back[k];
   }
   for (y = 0; y < h; y++)
      for (x = 0; x < w; x++) {
         float sum[3] = { 0, 0, 0 };
         float fade = 0.93f + 0.07f * (1 - (float)y / (float)h); /* the panel darkens a little downwards */
         for (j = 0; j < SUPER; j++)
            for (i = 0; i < SUPER; i++) {
               int sx = x * SUPER + i, sy = y * SUPER + j;
               const sample *q = b->at + (size_t)sy * (size_t)b->width + (size_t)sx;
               float base[3], n[3], l, light, open;
               if (q->depth <= 0) {
                  for (k = 0; k < 3; k++) sum[k] += panel_light[k] * fade;
                  continue;
               }
               l = sqrtf(dot(q->normal, q->normal));
               for (k = 0; k < 3; k++) n[k] = l > 1e-12f ? q->normal[k] / l : c->back[k];
               if (q->colour)
                  for (k = 0; k < 3; k++) base[k] = from_srgb((float)(q->colour >> (16 - 8 * k) & 255) / 255);
               else scale_colour(q->value > 0 ? q->value / top : 0, base);
               open = openness(b, sx, sy, 0.035f * (float)b->width, c->scale);
               light = 0.30f + 0.12f * dot(n, c->up) + 0.62f * fmaxf(dot(n, key), 0) + 0.16f * fmaxf(dot(n, fill_light), 0) +
                       0.14f * fmaxf(dot(n, rim), 0);
               if (q->value < 0) light *= 0.55f;
               for (k = 0; k < 3; k++) sum[k] += base[k] * light * open;
            }
         for (k = 0; k < 3; k++) sum[k] /= SUPER * SUPER;
         blend(im, ox + x, oy + y, pack(sum), 1);
      }
}

/* ===================================================================================== >>compare */
static const uint32_t ink = 0x2b2a28, soft_ink = 0x77736c, page = 0xfbfaf7;

/* the vertex around which, within `reach`, value times area adds up to most; area (V) is scratch */
static void find_spot(const ex_comparison *m, const ex_shape *s, float reach, float *area, float centre[3])
{
   size_t v, u, t, k, step = m->vertices / 1500 + 1;
   float most = -1;
   memset(area, 0, m->vertices * sizeof *area);
   for (t = 0; t < m->triangles; t++) {
      const uint32_t *id = m->triangle + 3 * t;
      float a[3], b[3], n[3];
      for (k = 0; k < 3; k++) {
         a[k] = s->positions[3 * id[1] + k] - s->positions[3 * id[0] + k];
         b[k] = s->positions[3 * id[2] + k] - s->positions[3 * id[0] + k];
      }
      n[0] = a[1] * b[2] - a[2] * b[1], n[1] = a[2] * b[0] - a[0] * b[2], n[2] = a[0] * b[1] - a[1] * b[0];
      for (k = 0; k < 3; k++) area[id[k]] += sqrtf(dot(n, n)) / 6;
   }
   memset(centre, 0, 3 * sizeof *centre);
   for (v = 0; v < m->vertices; v += step) {
      float sum = 0;
      const float *p = s->positions + 3 * v;
      for (u = 0; u < m->vertices; u += step) {
         const float *q = s->positions + 3 * u;
         float dx = p[0] - q[0], dy = p[1] - q[1], dz = p[2] - q[2], d = (dx * dx + dy * dy + dz * dz) / (reach * reach);
         if (d < 1) sum += (1 - d) * (s->value ? s->value[u] : 0) * area[u];
      }
      if (sum > most) most = sum, memcpy(centre, p, 3 * sizeof *centre);
   }
}

/* the direction from which most of the value around `centre` can be seen */
static void find_side(const ex_comparison *m, const ex_shape *s, const float centre[3], float radius, float *screen,
                      buffer *small, float *azimuth, float *elevation)
{
   static const float lift[2] = { 0.10f, 0.40f };
   float most = -1;
   int a, e;
   size_t i;
   for (e = 0; e < 2; e++)
      for (a = 0; a < 24; a++) {
         float turn = (float)a * (6.2831853f / 24), seen = 0;
         camera c = look(turn, lift[e], centre, radius, (float)small->width);
         raster(small, &c, m, s, screen);
         for (i = 0; i < (size_t)small->width * (size_t)small->height; i++)
            if (small->at[i].depth > 0 && fabsf(small->at[i].depth - c.eye) < radius && small->at[i].value > 0) seen += small->at[i].value;
         seen *= 1 + 0.5f * cosf(turn); /* rather from the front, which is +z by custom */
         if (seen > most) most = seen, *azimuth = turn, *elevation = lift[e];
      }
}

/* a round number near the given one: 1, 2 or 5 times a power of ten */
static float round_scale(float x)
{
   float p = powf(10, floorf(log10f(x > 1e-6f ? x : 1e-6f))), m = x / p;
   return p * (m < 1.5f ? 1.0f : m < 3.5f ? 2.0f : m < 7.5f ? 5.0f : 10.0f);
}
static int by_value(const void *a, const void *b)
{
   float x = *(const float *)a, y = *(const float *)b;
   return (x > y) - (x < y);
}

const char *ex_compare(const char *path, const ex_comparison *m)
{
   enum { MARGIN = 28, GAP = 16, WIDTH = 460, WHOLE = 600, CLOSE = 460, HEAD = 132, FOOT = 84, SIDE = 96 };
   const float samples = (float)SUPER;
   const ex_shape *key = m->shape + m->looked_at;
   float lo[3] = { 1e30f, 1e30f, 1e30f }, hi[3] = { -1e30f, -1e30f, -1e30f }, middle[3], spot[3], radius, reach, azimuth = 0,
         elevation = 0, top = 0.01f;
   float *screen = (float *)malloc(m->vertices * 3 * sizeof *screen);
   buffer small, whole, close_up;
   ex_image im;
   const char *why = NULL;
   size_t i, k, v;
   camera wide, near_by;
   int bad;
   memset(&im, 0, sizeof im);
   bad = buffer_create(&small, SIDE, SIDE);
   bad |= buffer_create(&whole, WIDTH * SUPER, WHOLE * SUPER);
   bad |= buffer_create(&close_up, WIDTH * SUPER, CLOSE * SUPER);
   bad |= ex_image_create(&im, 2 * MARGIN + m->shapes * WIDTH + (m->shapes - 1) * GAP, HEAD + WHOLE + GAP + CLOSE + FOOT, page);
   if (bad || !screen) why = "out of memory for the picture";
   if (!why) {
      for (i = 0; i < m->shapes; i++)
         for (v = 0; v < m->vertices; v++)
            for (k = 0; k < 3; k++) {
               lo[k] = fminf(lo[k], m->shape[i].positions[3 * v + k]);
               hi[k] = fmaxf(hi[k], m->shape[i].positions[3 * v + k]);
            }
      for (k = 0, radius = 0; k < 3; k++) middle[k] = (lo[k] + hi[k]) / 2, radius += (hi[k] - lo[k]) * (hi[k] - lo[k]);
      radius = sqrtf(radius) / 2;
      if (!(radius > 1e-6f)) radius = 1e-6f;
      reach = 0.10f * radius;
      find_spot(m, key, reach, screen, spot);
      find_side(m, key, spot, 2 * reach, screen, &small, &azimuth, &elevation);
      if (key->value) { /* the scale's end: the value that 1 vertex in 500 exceeds, rounded */
         memcpy(screen, key->value, m->vertices * sizeof *screen);
         qsort(screen, m->vertices, sizeof *screen, by_value);
         top = round_scale(screen[m->vertices - 1 - m->vertices / 500]);
      }
      { /* as large as fits: the extent across the view, not the bounding ball */
         float across = 0, along = 0, out[3];
         wide = look(azimuth, elevation, middle, radius, 1);
         for (i = 0; i < m->shapes; i++)
            for (v = 0; v < m->vertices; v++) {
               project(&wide, m->shape[i].positions + 3 * v, out);
               across = fmaxf(across, fabsf(out[0])), along = fmaxf(along, fabsf(out[1]));
            }
         wide.scale *= samples * 0.47f * fminf((float)WIDTH / across, (float)WHOLE / along);
         near_by = look(azimuth, elevation, spot, 2.4f * reach, WIDTH * SUPER);
      }
      { /* long titles are set smaller */
         float room = (float)(im.width - 2 * MARGIN), wide_title = ex_text_width(18, m->title);
         ex_text(&im, MARGIN, 50, wide_title > room ? 18 * room / wide_title : 18, ink, m->title);
      }
      for (i = 0; i < m->shapes; i++) {
         int x = (int)(MARGIN + i * (WIDTH + GAP)), y = HEAD;
         float out[3];
         int side = (int)(4.8f * reach * wide.scale / samples), cx, cy;
         ex_text(&im, (float)x, 92, 14, ink, m->shape[i].title);
         if (m->shape[i].caption) ex_text(&im, (float)x, 117, 10.5f, soft_ink, m->shape[i].caption);
         raster(&whole, &wide, m, m->shape + i, screen);
         shade(&im, x, y, &whole, &wide, top);
         project(&wide, spot, out);
         cx = x + WIDTH / 2 + (int)(out[0] / samples) - side / 2, cy = y + WHOLE / 2 + (int)(out[1] / samples);
         frame(&im, cx, cy - side * CLOSE / WIDTH / 2, side, side * CLOSE / WIDTH, ink, 0.55f);
         y += WHOLE + GAP;
         raster(&close_up, &near_by, m, m->shape + i, screen);
         shade(&im, x, y, &close_up, &near_by, top);
      }
      { /* the colour scale: lit as a surface that faces the eye */
         int x, y = (int)im.height - FOOT + 28, x0 = MARGIN, w = 2 * WIDTH / 3, h = 14;
         for (x = 0; x < w; x++) {
            float c[3];
            scale_colour((float)x / (float)(w - 1), c);
            for (k = 0; k < 3; k++) c[k] *= 0.78f;
            fill(&im, x0 + x, y, 1, h, pack(c));
         }
         for (i = 0; i <= 4; i++) {
            char text[32];
            float tx = (float)x0 + (float)i * (float)(w - 1) / 4;
            snprintf(text, sizeof text, i == 4 ? "%.3g+ cm" : "%.3g", (double)(top * 100 * (float)i / 4));
            fill(&im, (int)tx, y + h, 1, 5, soft_ink);
            ex_text(&im, i == 0 ? tx : i == 4 ? tx - 8 : tx - ex_text_width(9.5f, text) / 2, (float)(y + h + 20), 9.5f, soft_ink, text);
         }
         ex_text(&im, (float)(x0 + w + 64), (float)(y + 12), 11, ink, m->scale_title);
      }
      why = ex_png_write(path, &im);
   }
   free(screen), free(small.at), free(whole.at), free(close_up.at);
   ex_image_free(&im);
   return why;
}

/* ===================================================================================== >>panels */
const char *ex_panels(const char *path, const char *title, const ex_panel *panel, size_t rows, size_t columns)
{
   enum { MARGIN = 24, GAP = 12, WIDTH = 340, TALL = 420, HEAD = 64, LINE = 44 };
   float across = 1e-6f, low = 1e30f, high = -1e30f;
   size_t i, p, v, most = 1;
   float *screen;
   buffer b;
   ex_image im;
   const char *why = NULL;
   int bad;
   for (i = 0; i < rows * columns; i++) { /* one scale for all: half the widest, and the tallest */
      float ca = cosf(panel[i].turn), sa = sinf(panel[i].turn);
      for (p = 0; p < panel[i].parts; p++) {
         const ex_part *q = panel[i].part + p;
         if (q->vertices > most) most = q->vertices;
         for (v = 0; v < q->vertices; v++) {
            across = fmaxf(across, fabsf(ca * q->positions[3 * v] - sa * q->positions[3 * v + 2]));
            low = fminf(low, q->positions[3 * v + 1]), high = fmaxf(high, q->positions[3 * v + 1]);
         }
      }
   }
   memset(&im, 0, sizeof im);
   screen = (float *)malloc(most * 3 * sizeof *screen);
   bad = buffer_create(&b, WIDTH * SUPER, TALL * SUPER);
   bad |= ex_image_create(&im, 2 * MARGIN + columns * WIDTH + (columns - 1) * GAP, HEAD + rows * (TALL + LINE + GAP) + MARGIN, page);
   if (bad || !screen) why = "out of memory for the picture";
   if (!why) {
      float room = (float)(im.width - 2 * MARGIN), wide = ex_text_width(18, title), middle[3] = { 0, 0, 0 };
      float scale = 0.47f * fminf((float)WIDTH / across, 2 * (float)TALL / fmaxf(high - low, 1e-6f));
      middle[1] = (low + high) / 2;
      ex_text(&im, MARGIN, 40, wide > room ? 18 * room / wide : 18, ink, title);
      for (i = 0; i < rows * columns; i++) {
         int x = (int)(MARGIN + i % columns * (WIDTH + GAP)), y = (int)(HEAD + i / columns * (TALL + LINE + GAP));
         camera c = look(panel[i].turn, 0.06f, middle, high - low, 1);
         c.scale = scale * SUPER;
         raster_clear(&b);
         for (p = 0; p < panel[i].parts; p++) {
            const ex_part *q = panel[i].part + p;
            ex_comparison m;
            ex_shape s;
            memset(&m, 0, sizeof m), memset(&s, 0, sizeof s);
            m.vertices = q->vertices, m.triangles = q->triangles, m.triangle = q->triangle;
            s.positions = q->positions, s.normals = q->normals;
            raster_add(&b, &c, &m, &s, q->colour, screen);
         }
         if (panel[i].title) ex_text(&im, (float)x, (float)(y + 16), 12, ink, panel[i].title);
         if (panel[i].caption) ex_text(&im, (float)x, (float)(y + 34), 9.5f, soft_ink, panel[i].caption);
         shade(&im, x, y + LINE, &b, &c, 1);
      }
      why = ex_png_write(path, &im);
   }
   free(screen), free(b.at);
   ex_image_free(&im);
   return why;
}
