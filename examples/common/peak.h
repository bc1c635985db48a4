/*  peak.h - how many multiply-adds a second this processor does at most, by the instructions that a kernel uses

    what      loops over independent sums in registers: nothing is loaded, nothing waits
    bf16      vdpbf16ps where AVX-512 has it; int8: vpdpbusd, without it vpmaddubsw, vpmaddwd and an addition. Kernels that
              widen bf16 or int8 to float32 have its peak */
#ifndef EX_PEAK_H
#define EX_PEAK_H
#include "../../deformnet.h"

typedef enum ex_peak_kind { EX_PEAK_F32, EX_PEAK_BF16, EX_PEAK_INT8, EX_PEAKS } ex_peak_kind;
/*  10^9 operations a second, two for each multiply-add, on `threads` threads of par; takes a few milliseconds. Take the best
    of several: a peak can be missed, but not exceeded */
double ex_peak(ex_peak_kind kind, dn_kernel kernel, const dn_parallel *par, unsigned threads);

#endif
