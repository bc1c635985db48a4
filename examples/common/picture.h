/*  picture.h - pictures without a graphics library: a software rasteriser, a stroke font, a PNG writer
    shows     meshes side by side, shaded from their normals and coloured by a value per vertex
    not here  textures, transparency, anything fast
    flow      positions, normals, value (V) --z-buffer, 3 x 3 samples a pixel--> depth, normal, value per sample
              --light, occlusion from the depth buffer, colour scale--> image --text--> PNG */
#ifndef EX_PICTURE_H
#define EX_PICTURE_H
#include <stddef.h>
#include <stdint.h>

typedef struct ex_image {
   size_t width, height;
   unsigned char *rgb; /* (height,width,3) */
} ex_image;

/*  0 when it worked; every failure leaves an empty image */
int ex_image_create(ex_image *image, size_t width, size_t height, uint32_t colour /* 0xRRGGBB */);
void ex_image_free(ex_image *image);
/*  NULL, or the reason in one line */
const char *ex_png_write(const char *path, const ex_image *image);

/*  baseline at y, capital letters `size` pixels high; what the font lacks is drawn as a space */
void ex_text(ex_image *image, float x, float y, float size, uint32_t colour, const char *text);
float ex_text_width(float size, const char *text);

typedef struct ex_shape {
   const char *title, *caption;     /* above the picture; caption may be NULL */
   const float *positions, *normals; /* (V,3) */
   const float *value;              /* (V) in metres, coloured by the scale; NULL: plain clay */
} ex_shape;

typedef struct ex_comparison { /* shapes of one mesh, next to each other: whole, and a closer look */
   const char *title, *scale_title;
   size_t vertices, triangles;
   const uint32_t *triangle; /* (triangles,3) < vertices */
   size_t shapes;            /* 1 .. 4 */
   const ex_shape *shape;
   size_t looked_at;         /* the shape whose value decides where and from which side to look closer */
} ex_comparison;

/*  finds the spot of 1/10 of the body's height with the most value, the side that shows most of it, and draws.
    up is +y. NULL, or the reason in one line */
const char *ex_compare(const char *path, const ex_comparison *c);

typedef struct ex_part {             /* one mesh of several that stand together */
   size_t vertices, triangles;
   const uint32_t *triangle;         /* (triangles,3) < vertices */
   const float *positions, *normals; /* (V,3) */
   uint32_t colour;                  /* 0xRRGGBB, not 0 */
} ex_part;
typedef struct ex_panel {
   const char *title, *caption;      /* either may be NULL */
   size_t parts;
   const ex_part *part;
   float turn;                       /* of the eye about +y, radians: 0 from +z */
} ex_panel;

/*  panels (rows,columns) drawn to one scale, so that sizes compare; up is +y. NULL, or the reason in one line */
const char *ex_panels(const char *path, const char *title, const ex_panel *panel, size_t rows, size_t columns);

#endif
