/*  tool.h - what every example program needs: errors in one line, memory, time, numbers, its files, a rig's description
    state     the program's name, for its errors; set once, at the start of main */
#ifndef EX_TOOL_H
#define EX_TOOL_H
#include "../../deformnet.h"

/*  the name that errors start with; keeps the pointer */
void ex_program(const char *name);
/*  "program: ..." as one line to stderr; returns 1, the exit code of a failure */
int ex_say(const char *format, ...);
int ex_say_error(const char *file, const dn_error *error);
/*  the same for programs without anything to give back: exits */
void ex_die(const char *format, ...);

/*  zero-filled; NULL when it does not fit */
void *ex_take(size_t count, size_t size);
double ex_now_ms(void);
/*  of n numbers, which it sorts; the mean of the two in the middle when n is even; 0 when there are none */
double ex_median(double *x, size_t n);
int ex_ends_with(const char *s, const char *end);
/*  a whole number from low to high and nothing else; 0: it is not */
int ex_read_whole(const char *s, long low, long high, long *value);
/*  the precision of that name, "f32", "bf16" ..; -1: there is none */
int ex_precision_named(const char *name);
/*  how many threads a program uses that was not told: the processors, 8 at most */
unsigned ex_processors(void);
/*  a file that ships with the examples, from the working directory or beside the program; path is where it was found, or
    would be */
const char *ex_bundled(const char *program, const char *name, char *path, size_t size);

/*  a character as deformnet wants it: mesh, skin set and skeleton of d, which point into scene and skin; the rest is zero */
struct ex_scene;
void ex_describe(const struct ex_scene *scene, dn_rig_desc *d, dn_skin_set *skin);

#endif
