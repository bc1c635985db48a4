/*  tensors.h - read and write safetensors files, for the examples

    shows      the file format in full: 8 bytes of header length, a JSON header, packed little-endian rows
    not here   the library's own reader (deformnet.h, >>tensors), which needs no files and no libc
    reading    the whole file is read and checked before any tensor is seen; every pointer is aligned for its type
    writing    declare metadata and tensors, then put elements in any order; the file appears under its name
               only when it is complete
    errors     every function that can fail takes error[EX_ERROR], which receives one line naming the file */
#ifndef EX_TENSORS_H
#define EX_TENSORS_H
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define EX_ERROR 256     /* bytes of an error line */
/*  "path: format ..." to error[EX_ERROR], or nothing when error is NULL; returns 0, what a reader that fails returns */
int ex_fail(char *error, const char *path, const char *format, ...);
#define EX_MAX_RANK 8

typedef enum ex_dtype {
   EX_BOOL, EX_U8, EX_I8, EX_U16, EX_I16, EX_F16, EX_BF16, EX_U32, EX_I32, EX_F32, EX_U64, EX_I64, EX_F64, EX_DTYPES
} ex_dtype;
size_t ex_dtype_size(ex_dtype type);
const char *ex_dtype_name(ex_dtype type);   /* "F32" */

typedef struct ex_tensor {
   const char *name;
   ex_dtype type;
   size_t rank, shape[EX_MAX_RANK]; /* unused sides are 1 */
   size_t count, bytes;             /* elements; count * ex_dtype_size(type) */
   const void *data;                /* lives as long as the file is open */
} ex_tensor;

/* reading */
typedef struct ex_tensors ex_tensors;
ex_tensors *ex_tensors_open(const char *path, char *error);              /* NULL: see error */
void ex_tensors_close(ex_tensors *file);                                 /* NULL is allowed */
size_t ex_tensors_count(const ex_tensors *file);
const ex_tensor *ex_tensors_at(const ex_tensors *file, size_t index);
const ex_tensor *ex_tensors_find(const ex_tensors *file, const char *name);       /* NULL: not there */
const char *ex_tensors_meta(const ex_tensors *file, const char *key);             /* NULL: not there */
const char *ex_tensors_path(const ex_tensors *file);

/*  ex_tensors_get - a tensor that must be there with this rank; a side given as 0 may have any length
    sides is an array of rank lengths. NULL and one line in error when it is missing or of another shape. */
const ex_tensor *ex_tensors_get(const ex_tensors *file, const char *name, size_t rank, const size_t *sides, char *error);

/*  elements as float or uint32, whatever the stored type; count elements are written.
    ex_tensor_u32: 0 and an error line when a value is negative, fractional or too large */
void ex_tensor_f32(const ex_tensor *tensor, float *out);
int ex_tensor_u32(const ex_tensors *file, const ex_tensor *tensor, uint32_t *out, char *error);

/* writing */
typedef struct ex_writer ex_writer;
ex_writer *ex_writer_open(const char *path, char *error);
void ex_writer_meta(ex_writer *w, const char *key, const char *value);
void ex_writer_metaf(ex_writer *w, const char *key, const char *format, ...); /* value as by printf */
size_t ex_writer_tensor(ex_writer *w, const char *name, ex_dtype type, size_t rank, const size_t *shape); /* its id */
/*  elements [first, first+count) of a tensor; after the first put nothing more can be declared.
    Elements never put are zero. Not thread-safe: lock around it. */
void ex_writer_put(ex_writer *w, size_t id, size_t first, const void *data, size_t count);
/*  1 when the file is complete under its name; 0 and an error line otherwise, and no file. Frees w */
int ex_writer_close(ex_writer *w, char *error);

#ifdef __cplusplus
}
#endif
#endif
