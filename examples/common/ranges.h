/*  ranges.h - the ranges that an int8 model needs, from what its layers give in float32

    shows     dn_probe as a tap: every block's output, channel by channel, in histograms
    ranges    tensor NAME.range (2,width): least, most. Whole numbers q in -127 .. 127 stand for (least + most) / 2 + q step,
              step = (most - least) / 254; what lies outside is clipped
    choice    of the two ends of each channel: those that make the squared error least, step^2 / 12 for every number plus
              the squared distance of those outside. The sum is convex in the ends, which never pass what was seen
    which     the outputs that a later layer reads, pools included: not the features, not the last layer's, and not those
              of pre.N before another pre layer, which stay float32 */
#ifndef EX_RANGES_H
#define EX_RANGES_H
#include "../../deformnet.h"

typedef struct ex_ranges ex_ranges;
ex_ranges *ex_ranges_create(void); /* NULL: out of memory */
void ex_ranges_free(ex_ranges *r); /* NULL is allowed */
/*  a probe for the stages of any float32 model; runs with it add up. Out of memory shows in ex_ranges_choose */
dn_probe ex_ranges_probe(ex_ranges *r);
/*  ends every channel's range; clip 0: at the least and the most seen. 0: out of memory */
int ex_ranges_choose(ex_ranges *r, int clip);

/*  after that: range k, NULL when there are no more: (2,*width). name is the tensor's, "dense.0.3.range" */
const float *ex_ranges_at(const ex_ranges *r, size_t k, const char **name, size_t *width);
/*  how much was seen: numbers in all, those outside their range, and channels whose range is clipped, of how many */
typedef struct ex_ranges_report { double numbers, outside; size_t channels, clipped; } ex_ranges_report;
ex_ranges_report ex_ranges_describe(const ex_ranges *r);

/*  the model file at `path` with these tensors added, or in place of old ones, as `out`, which may be path: all else is
    written as it was read. 0 and one line in error[EX_ERROR] when that fails */
int ex_ranges_save(const ex_ranges *r, const char *path, const char *out, char *error);
/*  the same in memory: the bytes of a new file, to be freed; NULL: not such a file, or out of memory */
unsigned char *ex_ranges_join(const ex_ranges *r, const void *file, size_t size, size_t *joined);

#endif
