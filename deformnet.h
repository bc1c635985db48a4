/*  deformnet.h - v0.1.0 - neural deformation of skinned characters - MIT or public domain, see end of file

    #define DEFORMNET_IMPLEMENTATION in ONE C99 or C++11 file before including; elsewhere just include.

    WHAT       Skinning (LBS, DQS) bends a mesh by blending joint matrices: elbows pinch, wrists collapse,
               shoulders lose volume. This library runs a graph-attention network on the character's own
               mesh each frame and moves every vertex towards where an offline simulation put it. One model
               serves meshes of any topology that have its joints. No dependency but a C compiler.

    NOT HERE   training (examples/train), rendering, scene files (examples/common); the one file format
               is safetensors. No threads of its own: give it your job system (dn_parallel).
    SAFE WITH  hostile model files and meshes (tests/hostile.c). NOT checked per frame: arrays shorter than
               the counts you pass, memory you changed after bind.

    MAP        rest mesh --weld, bind--> graph (N nodes, one-rings) + rest descriptors, once per character
               model.safetensors --load--> packed layers, once
               palette (S,3,4) --skin--> coarse mesh --> rows (N,D) --network--> displacement (N,3)
               skinned vertex + displacement of its node --> positions, normals (V,3), every frame

    SAMPLE     (examples/minimal.c is this, complete)
               dn_error err;
               dn_model *model = dn_model_load_file("humanoid.safetensors", NULL, &err);
               dn_rig_desc d = {0};                          // mesh, skin and skeleton: fill in your pointers
               dn_rig *rig = model ? dn_rig_create(model, &d, NULL, NULL, &err) : NULL;
               if (!rig) return puts(err.info);                             // says what was found and expected
               size_t size;                                                 // one scratch per thread or job
               void *scratch = dn_scratch_create(rig, 1, NULL, &size, &err);
               each frame:
                  dn_pose pose = {0};  pose.palette = palette;  pose.strength = 1.0f;
                  dn_output out = {0}; out.positions = vertices; out.position_stride = sizeof(my_vertex);
                  dn_deform(rig, &pose, &out, scratch, size, NULL, &err);

    WORDS      V render vertices, N welded nodes, S joints (never "bones"), D row width, K heads,
               F features a head, B self channels; palette = joint transform times inverse bind
    UNITS      metres, radians, no axis assumed; float32, row-major, one row per node; column vectors
    PAPERS     T = Li, thesis on mesh deformation with GNNs; N = Neural Blend Shapes; C = Detail-Aware Deep
               Clothing. "T 3.4" is equation 3.4 there.
    ROOMS      search for the tag:
               >>config >>types >>bind >>model >>deform >>layers >>parts                (what you call)
               >>base >>tensors >>mesh >>skin >>geodesic >>kernels >>attention >>pooling
               >>networks >>rig >>frame                                                (how it works)
    STUDENTS   follow the MAP through the *_ref functions; each cites its equation. Build with DN_NO_SIMD and
               they are what runs (of pooling's contraction still the fast form, tested equal to its _ref).
*/
#ifndef DEFORMNET_H
#define DEFORMNET_H

/* ===================================================================================== >>config
   macro              set in          default       meaning
   DEFORMNET_STATIC   every file      off           all functions static: each file brings its own implementation
   DN_API             every file      extern        linkage of the public functions (DLL export; replaces extern "C" too)
   DN_ASSERT(x)       implementation  assert(x)     caller's mistakes only, never bad files
   DN_MALLOC DN_FREE  implementation  malloc/free   both or neither; dn_allocator gives per-object control
   DN_SQRTF DN_FABSF DN_SINF DN_COSF DN_SQRT DN_FABS  implementation  libm   all six or none
   DN_NO_STDIO        every file      off           no dn_model_load_file, no <stdio.h>
   DN_NO_SIMD         implementation  off           reference kernels only
   DN_MAX_DIM         implementation  1<<16         larger tensor sides are refused as hostile

   No macro changes the layout of a public struct. */
#include <stddef.h>
#include <stdint.h>

#define DN_VERSION 100 /* 0.1.0 */

#ifndef DN_API
   #ifdef DEFORMNET_STATIC
      #if defined(__GNUC__) || defined(__clang__)
         #define DN_API __attribute__((unused)) static
      #else
         #define DN_API static
      #endif
   #elif defined(__cplusplus)
      #define DN_API extern "C"
   #else
      #define DN_API extern
   #endif
#endif

/* ===================================================================================== >>types
   Everything here is plain data. Zero-filled is a valid default unless a field says otherwise. */

/* Results. The text is what dn_result_text returns; enum, text and tests come from this one list. */
#define DN_RESULTS(X)                                                                                        \
   X(OK, "ok") X(NO_MEMORY, "out of memory") X(TOO_SMALL, "memory given is too small")                       \
   X(CANCELLED, "cancelled by the progress callback") X(IO, "cannot read the file")                          \
   X(TRUNCATED, "data ends early") X(BAD_HEADER, "not a safetensors header")                                 \
   X(BAD_LAYOUT, "tensor data overlaps, has holes or runs past the file") X(BAD_TYPE, "unsupported tensor type") \
   X(MISSING_TENSOR, "tensor not in file") X(BAD_SHAPE, "shapes disagree") X(BAD_VALUE, "value out of range") \
   X(UNSUPPORTED, "not supported by this version") X(BAD_MESH, "mesh data out of range")                     \
   X(BAD_SKIN, "skin data out of range") X(MISSING_JOINT, "the skeleton lacks joints that the model names")  \
   X(NOT_FINITE, "some nodes were not finite and stayed plainly skinned")
#define DN__ENUM(id, text) DN_##id,
typedef enum dn_result { DN_RESULTS(DN__ENUM) DN_RESULT_COUNT } dn_result;
#undef DN__ENUM

typedef struct dn_error { /* the caller's; pass NULL if you do not care; written only when a call does not give DN_OK */
   const char *where;     /* static text: "model header", "bind", ... */
   dn_result code;        /* what the function also returned */
   size_t offset;         /* byte in the file, vertex, triangle or joint index; SIZE_MAX if none */
   char info[240];        /* "local.0.att_src: expected (8,16), file has (8,8)"; always terminated */
} dn_error;

typedef struct dn_allocator {                             /* zero-filled or NULL: DN_MALLOC / DN_FREE */
   void *(*alloc)(void *user, size_t size, size_t align); /* align is 64; NULL or a misaligned block: DN_NO_MEMORY */
   void (*free)(void *user, void *ptr, size_t size);      /* size as given to alloc; NULL: nothing is given back */
   void *user;                                            /* stored with the object: must outlive it */
} dn_allocator;

/* A caller's job system. run() calls fn on disjoint ranges that cover [0,count), cut on multiples of grain,
   worker < workers, no two ranges at once with one worker number; it returns when all are done. Ranges never
   share output, so results are the same bits for every run(), every number of workers. */
typedef void dn_range_fn(void *job, size_t begin, size_t end, unsigned worker);
typedef struct dn_parallel { /* NULL, or run == NULL: the library loops by itself */
   void (*run)(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job);
   void *user;
   unsigned workers; /* scratch is sized for this many; 0 counts as 1 */
} dn_parallel;

typedef struct dn_progress { /* NULL, or step == NULL: none. Called on the thread that called the library, between steps */
   int (*step)(void *user, const char *stage, float done); /* done in [0,1]; non-zero return cancels */
   void *user;
} dn_progress;

typedef enum dn_type { /* element types of caller's arrays; N = normalised to [0,1] */
   DN_F32, DN_U8, DN_U16, DN_U32, DN_U8N, DN_U16N
} dn_type;

typedef enum dn_matrix { /* how an affine matrix lies in memory; translation is always its last column */
   DN_3X4_ROWS,          /* 12 floats: row 0, row 1, row 2 */
   DN_3X4_COLUMNS,       /* 12 floats: column 0 (3), column 1, column 2, translation */
   DN_4X4_ROWS,          /* 16 floats, row-major: translation at 3, 7, 11 */
   DN_4X4_COLUMNS        /* 16 floats, column-major (glTF, OpenGL): translation at 12, 13, 14 */
} dn_matrix;

/* ===================================================================================== >>model
   A model is immutable after load and may be shared by any number of threads and rigs. It keeps no pointer
   into the file's bytes. */
typedef struct dn_model dn_model;

typedef enum dn_arch { DN_MLP, DN_GAT, DN_NEUROSKINNING, DN_DENSEGATS, DN_MULTIRESGNET } dn_arch;
typedef enum dn_pooling { DN_POOL_DYNAMIC, DN_POOL_REST } dn_pooling;
typedef enum dn_feature { DN_POSITION, DN_RELATIVE, DN_NORMAL, DN_GEODESIC, DN_DISTANCE } dn_feature;

typedef struct dn_model_info { /* strings and arrays belong to the model */
   dn_arch arch;
   const char *arch_name;
   size_t row_width;                /* D */
   size_t feature_count;
   const dn_feature *features;      /* in row order */
   size_t joints;                   /* S: columns of geodesic and distance, or names; 0: none of the three */
   const char *const *joint_names;  /* (S) or NULL: joints then match by index */
   int root_frame;                  /* deformnet.frame == "root" */
   dn_pooling pooling;
   float unit;                      /* metres per unit of the training data; not applied: pass the mesh in its units */
   const char *licence, *trained_on; /* "" when the file has none */
   size_t parameters;               /* numbers in the tensors used */
   size_t bytes;                    /* memory the model occupies */
} dn_model_info;

/*  dn_model_load - read a model from memory

    file      size bytes of a .safetensors file (spec: networks.md, section 6); not kept, any alignment
    allocator NULL for DN_MALLOC; the model remembers it
    errors    NULL, and *err names the tensor or metadata key, what was found and what was expected
    memory    at most a small multiple of the file; nothing is allocated before the header is checked
    threads   re-entrant */
DN_API dn_model *dn_model_load(const void *file, size_t size, const dn_allocator *allocator, dn_error *err);
#ifndef DN_NO_STDIO
/*  the same from a path; DN_IO when the file cannot be opened or read */
DN_API dn_model *dn_model_load_file(const char *path, const dn_allocator *allocator, dn_error *err);
#endif
/*  after the last rig that uses it; NULL is allowed; does nothing to a model made by dn_model_init, whose memory is yours */
DN_API void dn_model_free(dn_model *model);

/*  dn_model_size, dn_model_init - the same without an allocator, from an opened file (dn_tensors_open, >>parts)

    bytes      kept by the model; scratch is needed during dn_model_init only; both exact
    memory     both 64-byte aligned; memory must outlive the model, *model lies inside it. The file may go afterwards
    errors     as dn_model_load; DN_TOO_SMALL names both sizes; *model is NULL then
    threads    re-entrant */
typedef struct dn_tensors dn_tensors;
DN_API dn_result dn_model_size(const dn_tensors *file, size_t *bytes, size_t *scratch, dn_error *err);
DN_API dn_result dn_model_init(const dn_tensors *file, void *memory, size_t bytes, void *scratch, size_t scratch_bytes,
                               dn_model **model, dn_error *err);
/*  fills *info; what it points to lives as long as the model. Re-entrant, cannot fail */
DN_API void dn_model_describe(const dn_model *model, dn_model_info *info);

/* ===================================================================================== >>bind
   A rig is one character bound to one model: everything that depends on the rest mesh only. Immutable
   after bind; any number of threads may deform with it, each with its own scratch. */
typedef struct dn_rig dn_rig;

typedef struct dn_skin_set { /* one JOINTS_n / WEIGHTS_n pair of any width */
   size_t influences;        /* per vertex, 4 in glTF; those of weight 0 cost nothing */
   const void *joints;
   dn_type joint_type;       /* DN_U8, DN_U16, DN_U32 */
   size_t joint_stride;      /* bytes from vertex to vertex; 0: tightly packed */
   const void *weights;
   dn_type weight_type;      /* DN_F32, DN_U8N, DN_U16N */
   size_t weight_stride;
} dn_skin_set;

typedef struct dn_mesh {
   size_t vertices;          /* V, at least 1 */
   const float *positions;   /* (V,3) rest pose, model space, the model's unit (metres), finite */
   size_t position_stride;   /* bytes; 0: 12 */
   size_t triangles;         /* T, may be 0 */
   const void *indices;      /* (T,3), packed, each below V */
   dn_type index_type;       /* DN_U16, DN_U32 */
   size_t skin_sets;         /* at least 1 */
   const dn_skin_set *skin;
} dn_mesh;

typedef struct dn_skeleton {
   size_t joints;             /* S of the character */
   const char *const *names;  /* (S) or NULL; needed when the model names its joints */
   const int32_t *parents;    /* (S), -1 for roots, or NULL; only used to fold joints the model lacks */
   const float *inverse_bind; /* (S) matrices, or NULL for identity; gives the joints' rest positions */
   dn_matrix matrix;          /* their layout */
} dn_skeleton;

typedef enum dn_skinning { DN_LBS, DN_DQS } dn_skinning;

typedef struct dn_rig_desc {   /* borrowed during bind only */
   dn_mesh mesh;
   dn_skeleton skeleton;
   dn_skinning skinning;       /* what the coarse mesh is; models are trained on one, mostly LBS */
   float weld_distance;        /* vertices at most this far apart at rest may weld; 0: equal positions */
   unsigned resolution;        /* voxels along the longest side for geodesic distance; 0: 128, at most 512 */
   const float *geodesic;      /* (N,S_model) known distances in node and model joint order, or NULL: compute */
   size_t geodesic_nodes;      /* N of that array, checked */
   const dn_parallel *parallel;
   const dn_progress *progress;
} dn_rig_desc;

typedef struct dn_report { /* what bind found, written when it succeeds; nothing here is an error */
   size_t vertices, nodes, edges, components;
   size_t isolated_nodes;       /* without any edge */
   size_t seams_welded;         /* vertices that joined an earlier one */
   size_t seams_apart;          /* vertices left apart from one at their place: weights differ too much */
   size_t degenerate_triangles; /* with repeated nodes or exactly zero area */
   size_t influences_dropped;   /* negative weights, counted one by one */
   size_t weights_normalised;   /* vertices whose weights did not sum to 1 within 1e-3 */
   size_t weightless_vertices;  /* no positive weight: bound to joint 0 */
   size_t influences;           /* the most that any vertex uses */
   size_t joints_matched, joints_folded; /* named joints found; extra ones folded into an ancestor */
   size_t solid_cells;          /* geodesic voxels; 0 when the model needs none */
   float cell;                  /* their edge, metres */
} dn_report;

/*  dn_rig_create - bind a character to a model

    model      must outlive the rig. NULL makes a rig that skins only (dn_deform then adds nothing)
    desc       borrowed during the call
    allocator  NULL for DN_MALLOC; used for the rig and for temporary memory
    report     may be NULL
    joints     with names in the model, joints match by name, "mixamorig:" and "Armature|" style prefixes
               ignored; a named joint that the skeleton lacks is DN_MISSING_JOINT and listed; extra joints
               still skin, and the network sees their nearest named ancestor (or joint 0) in their place.
               Without names the counts must be equal
    errors     NULL; DN_BAD_MESH, DN_BAD_SKIN (joint index out of range where the weight is not 0, non-finite position or
               weight, triangle index out of range, no vertices): err->offset and info name the element; DN_BAD_VALUE,
               DN_BAD_SHAPE (a field of desc), DN_MISSING_JOINT, DN_CANCELLED, DN_NO_MEMORY: nothing is kept
    cost       geodesic distances dominate: S times the voxels; progress is reported there
    threads    re-entrant; desc->parallel may split the geodesic distances and the rest-pose network */
DN_API dn_rig *dn_rig_create(const dn_model *model, const dn_rig_desc *desc, const dn_allocator *allocator,
                             dn_report *report, dn_error *err);
/*  after the last frame that uses it; NULL is allowed; does nothing to a rig made by dn_rig_init, whose memory is yours */
DN_API void dn_rig_free(dn_rig *rig);

/*  dn_rig_size, dn_rig_init - the same without an allocator

    bytes      kept by the rig, an upper bound from the counts and the bounding box
    scratch    needed during dn_rig_init only, with the same desc and model
    memory     both 64-byte aligned; memory must outlive the rig, *rig lies inside it
    errors     as dn_rig_create; DN_TOO_SMALL names both sizes; *rig is NULL then */
DN_API dn_result dn_rig_size(const dn_model *model, const dn_rig_desc *desc, size_t *bytes, size_t *scratch,
                             dn_error *err);
DN_API dn_result dn_rig_init(const dn_model *model, const dn_rig_desc *desc, void *memory, size_t bytes,
                             void *scratch, size_t scratch_bytes, dn_rig **rig, dn_report *report, dn_error *err);

typedef struct dn_graph {  /* one-rings in CSR: neighbours of i are next[first[i]] .. next[first[i+1]-1] */
   size_t nodes;           /* N */
   const uint32_t *first;  /* (N+1) */
   const uint32_t *next;   /* (2E), ascending within a node, never the node itself */
} dn_graph;

typedef struct dn_rig_view {       /* what a rig holds, for tools, tests and training; do not write */
   size_t vertices, nodes, joints; /* joints: the character's */
   size_t bytes;
   dn_graph graph;
   const uint32_t *node_of_vertex; /* (V) */
   const uint32_t *first_vertex;   /* (N) the vertex that gave the node its position and weights */
   const float *rest;              /* (N,3) */
   size_t influences;              /* I */
   const uint32_t *skin_joint;     /* (V,I) the character's joints; unused entries repeat the first, weight 0 */
   const float *skin_weight;       /* (V,I) */
   size_t triangles;               /* those with three different nodes */
   const uint32_t *triangle;       /* (triangles,3) node indices */
   const float *joint_rest;        /* (S_model,3) rest positions of the model's joints */
   const uint32_t *joint_map;      /* (S_model) the character's index of each of the model's joints */
   const float *geodesic;          /* (N,S_model) metres, or NULL when the model does not use it */
} dn_rig_view;
/*  fills *view; what it points to lives as long as the rig. Re-entrant, cannot fail */
DN_API void dn_rig_describe(const dn_rig *rig, dn_rig_view *view);

/* ===================================================================================== >>deform */
typedef struct dn_pose {
   const float *palette;      /* (S_character) matrices in the character's joint order, model space */
   dn_matrix matrix;          /* their layout */
   float strength;            /* 0 plain skinning .. 1 the full displacement; clamped. Zero-filled means 0! */
   const float *mask;         /* (V) factor per vertex, clamped to [0,1], or NULL for all 1 */
   const float *skinned;      /* (V,3) positions your engine skinned already with this palette, model space, or NULL:
                                 skinned here; may be the same memory as out->positions */
   size_t skinned_stride;     /* bytes; 0: 12 */
} dn_pose;

typedef struct dn_output {    /* any pointer may be NULL, else (V,3) written in full; strides in bytes, 0: 12 */
   float *positions;          size_t position_stride;     /* refined, model space */
   float *normals;            size_t normal_stride;       /* of the refined mesh, unit or (0,0,0) */
   float *displacement;       size_t displacement_stride; /* refined - skinned, posed space */
   float *rest_delta;         size_t rest_delta_stride;   /* the same, to be added before skinning: GPU
                                                             skinning or a morph target then gives positions; 0
                                                             where a vertex's blended matrix is flat */
   float bounds_min[3], bounds_max[3]; /* written: box of the refined positions, NaN left out */
   size_t fallback_nodes;              /* written: nodes whose network output was not finite */
} dn_output;

/*  dn_deform - one frame: skin, describe, run the network, displace

    rig        and its model: read only, shared
    pose, out  see the structs; out arrays may be interleaved in one vertex buffer
    scratch    dn_scratch_size(rig, workers) bytes, 64-byte aligned, contents irrelevant before and after;
               one per thread or job
    parallel   NULL: this thread only. workers must not exceed what scratch was sized for
    returns    DN_OK, or DN_NOT_FINITE when out->fallback_nodes nodes stayed plainly skinned or the palette is not
               finite: the output is written in full either way, and *err says which.
               DN_TOO_SMALL when scratch is: nothing is written
    equation   v_i = p_i + strength mask_i Delta_node(i), p = LBS (T 2.1) or DQS (T 2.2)
    threads    re-entrant; no allocation, no I/O, no globals; bits independent of parallel */
DN_API dn_result dn_deform(const dn_rig *rig, const dn_pose *pose, dn_output *out, void *scratch,
                           size_t scratch_bytes, const dn_parallel *parallel, dn_error *err);
/*  bytes of scratch for one frame at a time with up to that many workers (0 counts as 1); SIZE_MAX: does not fit */
DN_API size_t dn_scratch_size(const dn_rig *rig, unsigned workers);
/*  dn_scratch_create - the same as an allocated block, 64-byte aligned

    bytes      written: dn_scratch_size(rig, workers), to be given to dn_deform and to dn_scratch_free
    allocator  NULL for DN_MALLOC; dn_scratch_free takes the same one
    errors     NULL and DN_NO_MEMORY, naming the size */
DN_API void *dn_scratch_create(const dn_rig *rig, unsigned workers, const dn_allocator *allocator, size_t *bytes, dn_error *err);
DN_API void dn_scratch_free(void *scratch, size_t bytes, const dn_allocator *allocator); /* NULL scratch is allowed */

typedef struct dn_probe { /* sees every block's output by tensor name: "pre.0" (N,64); slow, for tests */
   void (*tap)(void *user, const char *name, const float *rows, size_t first /* node */, size_t count, size_t width,
               size_t row_stride); /* the layers at the end come in tiles of nodes */
   void (*pool)(void *user, const char *name, const uint32_t *members /* (M,2) */, const float *score, size_t count);
   void *user;
} dn_probe;
/*  The four stages of dn_deform, for engines that time or schedule them apart. Call each once a frame, in this order,
    with the same rig, pose, scratch and number of workers: each works in place on what the one before left there.
    dn_deform is exactly these four.

    skin       palette -> skinned vertices (T 2.1, T 2.2); the one that checks scratch_bytes: go on only after DN_OK
    rows       -> rows (N,D) of the descriptors, in the network's frame (spec section 3)
    network    -> displacement (N,3) in model space; nodes that are not finite get 0. probe: NULL, or it sees the
               blocks, called on this thread
    output     -> the caller's arrays; returns as dn_deform
    threads    re-entrant, as dn_deform */
DN_API dn_result dn_stage_skin(const dn_rig *rig, const dn_pose *pose, void *scratch, size_t scratch_bytes,
                               const dn_parallel *parallel, dn_error *err);
DN_API void dn_stage_rows(const dn_rig *rig, void *scratch, const dn_parallel *parallel);
DN_API void dn_stage_network(const dn_rig *rig, void *scratch, const dn_parallel *parallel, const dn_probe *probe);
DN_API dn_result dn_stage_output(const dn_rig *rig, const dn_pose *pose, dn_output *out, void *scratch,
                                 const dn_parallel *parallel, dn_error *err);
/*  what the stages left in scratch, per node; 64-byte aligned, valid until the next call that uses the scratch */
DN_API const float *dn_scratch_coarse(const dn_rig *rig, const void *scratch);       /* (N,3) skinned */
DN_API const float *dn_scratch_rows(const dn_rig *rig, const void *scratch);         /* (N,D); dn_stage_network normalises them */
DN_API const float *dn_scratch_displacement(const dn_rig *rig, const void *scratch); /* (N,3) posed, model space */

/* ===================================================================================== >>layers
   The networks' building blocks, to compose your own. A layer is packed once into memory you give (weights
   in panels of DN_PANEL columns, batch norm and bias folded in) and then only read. Rows x and y have a stride
   in floats, so that several blocks can share one wide row (a dense module concatenates in place).
   All of them: re-entrant, no allocation, memory and scratch 64-byte aligned; out must not overlap in unless said;
   bits independent of parallel; sizes that do not match are the caller's mistake, asserted where they can be seen.
   dn_linear, dn_gat and dn_pool_contract have a plain *_ref twin, the specification: the first two stay within
   1e-5 + 1e-4 |x| of it, the third equals it. The others are plain loops over those. */
#define DN_PANEL 16

/* Which text runs. Packing a layer stores the fastest one that works here in its `kernel`; tests and benchmarks
   may overwrite it with any available one. Zero-filled is the reference. */
typedef enum dn_kernel { DN_KERNEL_REF, DN_KERNEL_SSE, DN_KERNEL_AVX2, DN_KERNEL_AVX512, DN_KERNEL_NEON,
                         DN_KERNEL_WASM, DN_KERNEL_COUNT } dn_kernel;
DN_API int dn_kernel_available(dn_kernel kernel); /* compiled in, and this processor and system run it */

typedef enum dn_activation {
   DN_ACT_NONE, DN_ACT_TANH, DN_ACT_RELU, DN_ACT_LEAKYRELU /* slope 0.2 */, DN_ACT_TANHSHRINK /* x - tanh x */,
   DN_ACT_SOFTMAX /* over the row */
} dn_activation;

typedef struct dn_batchnorm { const float *weight, *bias, *mean, *var; } dn_batchnorm; /* (C) each, eps 1e-5 */

typedef struct dn_linear {  /* y = act(bn(W x + b)) */
   size_t in, out;
   dn_activation activation;
   const float *panels;     /* (ceil(out/16), in, 16) */
   const float *bias;       /* (ceil(out/16)*16), zero padded */
   dn_kernel kernel;
} dn_linear;
/*  bytes for dn_linear_pack; 0 when a size is 0 or the product does not fit */
DN_API size_t dn_linear_size(size_t in, size_t out);
/*  weight (out,in) row-major; bias (out) or NULL; bn over out channels or NULL; memory 64-byte aligned */
DN_API void dn_linear_pack(dn_linear *layer, size_t in, size_t out, const float *weight, const float *bias,
                           const dn_batchnorm *bn, dn_activation activation, void *memory);
/*  x (rows,in) with x_stride >= in -> y (rows,out) with y_stride >= out; strides in floats; y must not overlap x */
DN_API void dn_linear_ref(const dn_linear *layer, const float *x, size_t x_stride, size_t rows, float *y, size_t y_stride);
DN_API void dn_linear_run(const dn_linear *layer, const float *x, size_t x_stride, size_t rows, float *y, size_t y_stride,
                          const dn_parallel *parallel);

/*  dn_gat - one self-reinforced graph-attention block (self = 0: a plain GAT layer)

    for node i and head k, with j running over the one-ring of i and i itself:
        z_j   = W_k v_j                                              T 3.2
        c_i   = H v_i                                                T 3.3, absent when self = 0
        a_ij  = softmax_j( leaky( dst_k . z_i + src_k . z_j ) )      T 3.4, a = [dst || src], slope 0.2
        y_i   = act(bn([ sum_j a_ij z_j, k = 0..K-1 || c_i ]))       T 3.5 */
typedef struct dn_gat {
   size_t in, heads, features, self; /* d, K, F, B; the output is K*F + B wide */
   dn_activation activation;
   const float *panels;     /* (.., in, 16) columns [K*F z | K dst logits | K src logits, padded] [B self, padded] */
   const float *bias;       /* one a column */
   const uint32_t *head;    /* (K*F, rounded up to 16) the head of each column of z */
   dn_kernel kernel;
} dn_gat;
/*  bytes for dn_gat_pack; 0 when in, heads or features is 0 or a product does not fit */
DN_API size_t dn_gat_size(size_t in, size_t heads, size_t features, size_t self);
/*  any activation but softmax; memory of dn_gat_size bytes, kept by the block
    lin (K*F,in), att_dst (K,F), att_src (K,F), self_weight (B,in) or NULL; bn over K*F+B channels or NULL */
DN_API void dn_gat_pack(dn_gat *block, size_t in, size_t heads, size_t features, size_t self, const float *lin,
                        const float *att_dst, const float *att_src, const float *self_weight, const dn_batchnorm *bn,
                        dn_activation activation, void *memory);
DN_API size_t dn_gat_scratch(const dn_gat *block, size_t nodes); /* bytes, 64-byte aligned */
/*  v (N,in) -> y (N,K*F+B), strides in floats; scratch of dn_gat_scratch bytes, garbage afterwards */
DN_API void dn_gat_ref(const dn_gat *block, const dn_graph *g, const float *v, size_t v_stride, float *y, size_t y_stride,
                       void *scratch);
/*  v and y may be columns of one row as long as they do not overlap */
DN_API void dn_gat_run(const dn_gat *block, const dn_graph *g, const float *v, size_t v_stride, float *y, size_t y_stride,
                       void *scratch, const dn_parallel *parallel);
/*  the attention itself: alpha (N + 2E, K), rows of node i at first[i] + i: the node itself first, then its
    one-ring in order; scratch as dn_gat_run; every row of a (node, head) sums to one */
DN_API void dn_gat_attention(const dn_gat *block, const dn_graph *g, const float *v, size_t v_stride, float *alpha,
                             void *scratch);

/*  dn_dense_run - a dense module (T 3.6): x_0 = v, x_{b+1} = f_b(x_b) || x_b, newest first

    rows       (N, row_stride): on entry the LAST blocks[0].in columns of the first `width` hold x_0; on return
               all `width` columns hold x_m, written in place from right to left, nothing copied
    width      blocks[0].in + sum of the blocks' widths
    scratch    the largest dn_gat_scratch of the blocks */
DN_API void dn_dense_run(const dn_gat *blocks, size_t count, const dn_graph *g, float *rows, size_t row_stride, size_t width,
                         void *scratch, const dn_parallel *parallel);

/*  Edge-contraction pooling (T 3.10-3.12). Scores are a one-head attention over N(i) without i. All directed
    edges in order of falling score (ties: smaller i, then j) contract when neither end is taken. */
typedef struct dn_pool {
   size_t in;
   const float *dst, *src; /* (in) W^T att_dst and W^T att_src: the scores need no more of W */
   float offset;           /* name.offset, 0 when absent */
} dn_pool;
typedef struct dn_clusters {  /* a contraction of a graph of N nodes; arrays of capacity N, written by the calls */
   size_t count;              /* M coarse nodes, ordered by their smaller member */
   uint32_t *members;         /* (M,2) directed pair (i,j); (i,i) for a node left alone; capacity (N,2) */
   float *score;              /* (M) 1 for a node left alone */
   uint32_t *cluster;         /* (N) */
   dn_graph graph;            /* coarse graph; graph.first and .next point to coarse_first, coarse_next */
   uint32_t *coarse_first;    /* (N+1) */
   uint32_t *coarse_next;     /* (2E) */
} dn_clusters;
/*  bytes for dn_pool_pack; 0 when a size is 0 or does not fit */
DN_API size_t dn_pool_size(size_t in, size_t features);
/*  lin (F,in), att_dst (F), att_src (F); memory is kept by the pool */
DN_API void dn_pool_pack(dn_pool *pool, size_t in, size_t features, const float *lin, const float *att_dst,
                         const float *att_src, float offset, void *memory);
DN_API size_t dn_pool_scratch(size_t nodes, size_t neighbours /* 2E */); /* bytes for the calls below */
/*  v (N,in) -> scores (2E), one per entry of g->next; those of a node sum to one                          T 3.10 */
DN_API void dn_pool_scores(const dn_pool *pool, const dn_graph *g, const float *v, size_t v_stride, float *scores,
                           void *scratch, const dn_parallel *parallel);
/*  the greedy contraction and the coarse graph, from the scores */
DN_API void dn_pool_contract(const dn_graph *g, const float *scores, dn_clusters *clusters, void *scratch);
/*  the plain one to read: sorts with insertion, tests membership by scanning; slow */
DN_API void dn_pool_contract_ref(const dn_graph *g, const float *scores, dn_clusters *clusters, void *scratch);
/*  new scores for a contraction found earlier ("rest" pooling): only the chosen pairs, direction kept */
DN_API void dn_pool_rescore(const dn_pool *pool, const dn_graph *g, const float *v, size_t v_stride, dn_clusters *clusters,
                            const dn_parallel *parallel);
/*  coarse (M,width) = score (v_i + v_j), or v_i alone; then back: both members get g / score */
DN_API void dn_pool_gather(const dn_pool *pool, const dn_clusters *c, const float *v, size_t v_stride, size_t width,
                           float *coarse, size_t coarse_stride, const dn_parallel *parallel);
DN_API void dn_pool_scatter(const dn_pool *pool, const dn_clusters *c, const float *coarse, size_t coarse_stride, size_t width,
                            size_t nodes, float *v, size_t v_stride, const dn_parallel *parallel);

/* ===================================================================================== >>parts
   What bind and deform are made of, callable on its own. All re-entrant, without allocation; arrays are packed;
   scratch is 64-byte aligned, its contents irrelevant before and garbage after. Inputs are trusted here (finite
   positions, indices below their counts): bind is what checks them. A size query that gives SIZE_MAX does not fit. */

/*  dn_weld - vertices at one place with like weights become one node (spec section 1)

    weights    (V,I) with joints (V,I), or both NULL: positions alone decide
    distance   0: equal as numbers (-0 equals +0)
    node_of_vertex (V), first_vertex (V capacity) are written; returns N. apart may be NULL
    scratch    dn_weld_scratch(V) bytes */
DN_API size_t dn_weld_scratch(size_t vertices);
DN_API size_t dn_weld(const float *positions, size_t vertices, const uint32_t *joints, const float *weights,
                      size_t influences, float distance, uint32_t *node_of_vertex, uint32_t *first_vertex, size_t *apart,
                      void *scratch);
/*  dn_graph_build - undirected edges of all triangles, each once, as CSR

    triangle   (T,3) node indices < nodes; repeated nodes add only their proper edges
    first      (nodes+1); next: capacity 6*T; scratch: dn_graph_scratch(nodes, T) bytes */
DN_API size_t dn_graph_scratch(size_t nodes, size_t triangles);
DN_API void dn_graph_build(const uint32_t *triangle, size_t triangles, size_t nodes, uint32_t *first, uint32_t *next,
                           dn_graph *g, void *scratch);
/*  area-weighted normals (spec section 1), positions and normals (nodes,3), unit or (0,0,0) */
DN_API void dn_normals(const float *positions, size_t nodes, const uint32_t *triangle, size_t triangles, float *normals);

/*  Rodrigues (T 3.8): axis-angle (3) -> rotation 3x3 row-major */
DN_API void dn_rodrigues(const float axis_angle[3], float rotation[9]);
/*  Gram-Schmidt on the columns x, y; z = x cross y; identity if degenerate (spec section 2). m 3x3 row-major */
DN_API void dn_orthonormalise(const float m[9], float rotation[9]);
/*  forward kinematics: local rotations (S,9), offsets (S,3) from the parent (the root's: its position), parents
    before children -> model-space transforms (S,12) row-major 3x4 */
DN_API void dn_forward_kinematics(const int32_t *parents, const float *offsets, const float *rotations, size_t joints,
                                  float *transforms);
/*  palette entry = transform * inverse bind (T 2.1); all (S,12), 3x4 row-major; palette may be transforms */
DN_API void dn_palette(const float *transforms, const float *inverse_bind, size_t joints, float *palette);
/*  LBS (T 2.1) and DQS (T 2.2) of `count` points: rest (count,3), joint and weight (count,influences), each joint below
    the palette's S; palette (S,12) row-major 3x4 -> out (count,3), which may be rest */
DN_API void dn_lbs(const float *rest, const uint32_t *joint, const float *weight, size_t influences, size_t count,
                   const float *palette, float *out);
DN_API void dn_dqs(const float *rest, const uint32_t *joint, const float *weight, size_t influences, size_t count,
                   const float *palette, float *out);

/*  dn_geodesic - volumetric geodesic distance from every point to every joint (T 3.2.1, spec section 3)

    positions  (N,3) rest nodes; triangle (T,3) node indices; joints (S,3)
    resolution cells along the longest side
    distance   (N,S) metres
    error      on a convex solid at most 3 % + 1 cell of the true distance
    progress   called between joints on the calling thread, never beside the work: no locks needed
    returns    DN_OK, DN_CANCELLED, DN_TOO_SMALL; cells and cell size in *solid_cells, *cell when not NULL
    scratch    dn_geodesic_scratch bytes (from the bounding box), 64-byte aligned */
DN_API size_t dn_geodesic_scratch(const float *positions, size_t nodes, size_t triangles, unsigned resolution, unsigned workers);
DN_API dn_result dn_geodesic(const float *positions, size_t nodes, const uint32_t *triangle, size_t triangles,
                             const float *joints, size_t joint_count, unsigned resolution, float *distance,
                             size_t *solid_cells, float *cell, void *scratch, size_t scratch_bytes,
                             const dn_parallel *parallel, const dn_progress *progress);
/*  dn_voxel_bind - skin weights for an unskinned mesh (Dionne & de Lasa 2013): geodesic distance to each bone (the
    segment from a joint to each child; a joint without children is a point), falloff
    w = 1 / ((1-a) d + a d^2)^2, a in [0,1], d in longest sides of the bounding box, the largest `influences` kept
    and normalised, largest first

    positions, triangle, joints, resolution, progress and results as dn_geodesic; d of the falloff is the distance
    parents    (S), any order, -1 for roots
    written    joint (N,influences), weight (N,influences), each row summing to one; entries beyond S: joint 0, weight 0
    scratch    dn_voxel_bind_scratch bytes */
DN_API size_t dn_voxel_bind_scratch(const float *positions, size_t nodes, size_t triangles, size_t joint_count,
                                    unsigned resolution, unsigned workers);
DN_API dn_result dn_voxel_bind(const float *positions, size_t nodes, const uint32_t *triangle, size_t triangles,
                               const float *joints, const int32_t *parents, size_t joint_count, unsigned resolution,
                               float falloff, size_t influences, uint32_t *joint, float *weight, void *scratch,
                               size_t scratch_bytes, const dn_parallel *parallel, const dn_progress *progress);

/* A read-only view of a safetensors file, for tools and tests; the model loader uses the same reader. */
typedef struct dn_tensor {
   const char *name;       /* terminated; inside the memory given to dn_tensors_open */
   const unsigned char *data; /* inside the file; any alignment: read with dn_tensor_floats */
   int format;                /* DN_ST_F32 ... */
   unsigned rank;             /* at most 8; over 4 the format is DN_ST_OTHER */
   size_t shape[4];           /* the first four sides */
   size_t count;              /* product of the shape, 1 for rank 0 */
} dn_tensor;
enum { DN_ST_F32, DN_ST_F16, DN_ST_BF16, DN_ST_I32, DN_ST_OTHER /* legal, but not converted here */ };
/*  bytes that dn_tensors_open needs, at most about three times the header: one pass that checks its syntax, types,
    shapes and ranges; dn_tensors_open adds what needs a table, names that repeat and ranges that overlap or leave holes */
DN_API dn_result dn_tensors_size(const void *file, size_t size, size_t *bytes, dn_error *err);
/*  file is borrowed and must outlive the view, which is read only and re-entrant; memory 16-byte aligned, of the bytes
    that dn_tensors_size told, *tensors lies inside it; on any error *tensors is NULL and *err says what was found where */
DN_API dn_result dn_tensors_open(const void *file, size_t size, void *memory, size_t bytes, dn_tensors **tensors, dn_error *err);
DN_API size_t dn_tensors_count(const dn_tensors *t);
DN_API const dn_tensor *dn_tensors_at(const dn_tensors *t, size_t index);
DN_API const dn_tensor *dn_tensors_find(const dn_tensors *t, const char *name); /* NULL if absent; expected O(1) */
DN_API const char *dn_tensors_meta(const dn_tensors *t, const char *key);       /* NULL if absent */
/*  convert `count` elements from element `from` on, all of them below t->count; F32, F16, BF16, I32 -> out (count) */
DN_API void dn_tensor_floats(const dn_tensor *t, size_t from, size_t count, float *out);
DN_API void dn_tensor_ints(const dn_tensor *t, size_t from, size_t count, int32_t *out); /* I32 only */

DN_API const char *dn_result_text(dn_result result); /* the list above; never NULL */
DN_API const char *dn_kernel_name(void); /* "avx512", "avx2", "sse", "neon", "wasm", "reference": what packing chooses */

#endif /* DEFORMNET_H */

#if defined(DEFORMNET_IMPLEMENTATION) && !defined(DN__IMPLEMENTED)
#define DN__IMPLEMENTED

/* ===================================================================================== >>base
   what every room uses: replaceable libc, checked arithmetic, the arena, errors, the parallel loop
   touches  nothing of its own: no statics anywhere in this file but constant tables */
#include <string.h>

#ifndef DN_ASSERT
   #include <assert.h>
   #define DN_ASSERT(x) assert(x)
#endif
#if defined(DN_MALLOC) != defined(DN_FREE)
   #error "deformnet: define both DN_MALLOC and DN_FREE, or neither"
#endif
#ifndef DN_MALLOC
   #include <stdlib.h>
   #define DN_MALLOC(size) malloc(size)
   #define DN_FREE(ptr) free(ptr)
#endif
#if defined(DN_SQRTF) != defined(DN_FABSF) || defined(DN_SQRTF) != defined(DN_SINF) || \
    defined(DN_SQRTF) != defined(DN_COSF) || defined(DN_SQRTF) != defined(DN_SQRT) || defined(DN_SQRTF) != defined(DN_FABS)
   #error "deformnet: define all of DN_SQRTF DN_FABSF DN_SINF DN_COSF DN_SQRT DN_FABS, or none"
#endif
#ifndef DN_SQRTF
   #include <math.h>
   #define DN_SQRTF(x) sqrtf(x)
   #define DN_FABSF(x) fabsf(x)
   #define DN_SINF(x) sinf(x)
   #define DN_COSF(x) cosf(x)
   #define DN_SQRT(x) sqrt(x)
   #define DN_FABS(x) fabs(x)
#endif
#ifndef DN_NO_STDIO
   #include <stdio.h>
#endif
#ifndef DN_MAX_DIM
   #define DN_MAX_DIM ((size_t)1 << 16)
#endif
#define DN__ALIGN ((size_t)64)

/* --- checked arithmetic: no size that came from outside is multiplied, added or rounded without these.
   They saturate: SIZE_MAX means "does not fit", stays SIZE_MAX through further steps, and no block is that big. */
static size_t dn__mul(size_t a, size_t b) { return b != 0 && a > SIZE_MAX / b ? SIZE_MAX : a * b; }
static size_t dn__add(size_t a, size_t b) { return a > SIZE_MAX - b ? SIZE_MAX : a + b; }
static size_t dn__round(size_t a, size_t unit) /* up; unit is a power of two */
{
   return a > SIZE_MAX - (unit - 1) ? SIZE_MAX : (a + (unit - 1)) & ~(unit - 1);
}
static size_t dn__min(size_t a, size_t b) { return a < b ? a : b; }
static size_t dn__max(size_t a, size_t b) { return a > b ? a : b; }
static unsigned dn__workers(const dn_parallel *p) { return p && p->run && p->workers > 1 ? p->workers : 1; }

/* finite without libm's macros, which some flags (-ffast-math) turn into constants */
static int dn__finite(float x)
{
   uint32_t u;
   memcpy(&u, &x, 4);
   return (u & 0x7f800000u) != 0x7f800000u;
}

/* --- arena: one block, carved front to back in 64-byte steps. With base == NULL it only measures: the size
   queries and the initialisers run the same layout code, so they cannot disagree. */
typedef struct dn__arena {
   unsigned char *base; /* NULL: measuring */
   size_t used, size;   /* used saturates; used > size means the block is too small */
} dn__arena;
static dn__arena dn__arena_of(void *memory, size_t size)
{
   dn__arena a;
   a.base = (unsigned char *)memory;
   a.used = 0;
   a.size = size;
   return a;
}
static void *dn__take(dn__arena *a, size_t count, size_t unit) /* NULL while measuring and when full */
{
   size_t at = a->used, bytes = dn__round(dn__mul(count, unit), DN__ALIGN);
   a->used = dn__add(at, bytes);
   return a->base && a->used <= a->size ? a->base + at : NULL;
}
static size_t dn__gauge(const dn__arena *a) { return a->used; }

/* --- allocator: zero-filled or NULL means DN_MALLOC, aligned by hand with the raw pointer kept in front */
static void *dn__alloc(const dn_allocator *al, size_t size)
{
   if (size == 0 || size > SIZE_MAX / 2) return NULL;
   if (al && al->alloc) {
      void *p = al->alloc(al->user, size, DN__ALIGN);
      if (!p || ((uintptr_t)p & (DN__ALIGN - 1)) == 0) return p;
      if (al->free) (al->free)(al->user, p, size); /* misaligned: as good as none */
      return NULL;
   }
   {
      unsigned char *raw = (unsigned char *)DN_MALLOC(size + DN__ALIGN + sizeof(void *)), *p;
      if (!raw) return NULL;
      p = raw + sizeof(void *);
      p += (DN__ALIGN - ((size_t)(uintptr_t)p & (DN__ALIGN - 1))) & (DN__ALIGN - 1);
      memcpy(p - sizeof(void *), &raw, sizeof(void *));
      return p;
   }
}
static void dn__release(const dn_allocator *al, void *ptr, size_t size)
{
   if (!ptr) return;
   if (al && al->alloc) {
      if (al->free) (al->free)(al->user, ptr, size); /* in brackets: debug heaps make free(p) a macro */
   } else {
      void *raw;
      memcpy(&raw, (unsigned char *)ptr - sizeof(void *), sizeof(void *));
      DN_FREE(raw);
   }
}

/* --- errors: text is put together without stdio, so that DN_NO_STDIO builds report just as well */
typedef struct dn__text { char *at, *end; } dn__text;
static void dn__put(dn__text *t, const char *s)
{
   while (*s && t->at < t->end) *t->at++ = *s++;
   *t->at = 0;
}
static void dn__put_u64(dn__text *t, uint64_t v)
{
   char digits[24];
   int n = 23;
   digits[n] = 0;
   do digits[--n] = (char)('0' + (int)(v % 10)), v /= 10; while (v);
   dn__put(t, digits + n);
}
static void dn__put_size(dn__text *t, size_t v) { dn__put_u64(t, v); }
static dn__text dn__text_of(char *buffer, size_t size)
{
   dn__text t;
   t.at = buffer;
   t.end = buffer + size - 1;
   *buffer = 0;
   return t;
}
/* All failures pass here: one place for a breakpoint. Returns code. A NULL err is the caller's choice. */
static dn_result dn__fail(dn_error *err, dn_result code, const char *where, size_t offset, const char *info)
{
   if (err) {
      dn__text t = dn__text_of(err->info, sizeof err->info);
      err->where = where;
      err->code = code;
      err->offset = offset;
      dn__put(&t, info);
   }
   return code;
}
/* "NAME: found A, expected B" with whatever parts are given (NULL parts are left out) */
static dn_result dn__fail_sizes(dn_error *err, dn_result code, const char *where, size_t offset, const char *before,
                                size_t a, const char *between, size_t b, const char *after)
{
   char line[240];
   dn__text t = dn__text_of(line, sizeof line);
   dn__put(&t, before);
   dn__put_size(&t, a);
   if (between) dn__put(&t, between), dn__put_size(&t, b);
   if (after) dn__put(&t, after);
   return dn__fail(err, code, where, offset, line);
}
#define DN__TEXT(id, text) text,
DN_API const char *dn_result_text(dn_result result)
{
   static const char *const texts[] = { DN_RESULTS(DN__TEXT) };
   return (unsigned)result < (unsigned)DN_RESULT_COUNT ? texts[result] : "unknown result";
}
#undef DN__TEXT

/* --- the parallel loop: hands the caller's hook the job, or runs it here */
static void dn__for(const dn_parallel *p, size_t count, size_t grain, dn_range_fn *fn, void *job)
{
   if (count == 0) return;
   if (p && p->run && p->workers > 1 && count > grain) p->run(p->user, count, grain, fn, job);
   else fn(job, 0, count, 0);
}


/* ===================================================================================== >>tensors
   in       the bytes of a .safetensors file, from anywhere: nothing in them is trusted
   out      a table of tensors and metadata that points into the file and into the memory given
   touches  that memory; no allocation, no recursion, no locale
   format   8 bytes little-endian header length, the header in JSON, then the data, packed, without holes:
            {"__metadata__":{"key":"text"}, "name":{"dtype":"F32","shape":[2,3],"data_offsets":[0,24]}}
   strict   the JSON is exactly that: any other key, type or nesting is refused where it stands, so depth is 3 by
            construction and time is linear in the header (n log n in the sort of n ranges). Legal: members in any order,
            white space, escapes, tensors in any order, rank 0, sides of 0, types that cannot be converted here.
   read     dn__tensors_scan first: it runs twice, once to check and count, once to fill the table */
#define DN__HEADER_CAP 100000000u /* the format's own limit */
#define DN__RANK_CAP 8u           /* as far as a shape is read; over 4 the tensor becomes DN_ST_OTHER */
#define DN__PROBE_CAP 256u        /* a table half full has no such runs, unless the names were made to collide */

typedef struct dn__entry {
   dn_tensor tensor;
   size_t bytes; /* of its data; begin is tensor.data - data */
} dn__entry;
typedef struct dn__names { /* open addressing, at most half full, so that a search always meets an empty slot */
   uint32_t *slot;         /* (mask+1) index + 1, 0 for an empty one */
   size_t mask;
} dn__names;
struct dn_tensors {
   size_t count, metas;
   dn__entry *entry;          /* (count) in the header's order */
   uint32_t *order;           /* (count) by rising offset, once sorted */
   uint32_t *meta;            /* (metas) where in text a key starts; its value follows it */
   dn__names names, keys;
   char *text;                /* unescaped names, keys and values, each terminated */
   size_t text_size;
   const unsigned char *data; /* the data section */
   size_t data_size;
};

/* --- the header as a row of characters, and the one place where its errors are put together */
typedef struct dn__json {
   const unsigned char *file;
   size_t at, end;               /* bytes of the file */
   const char *kind;             /* "tensor", "metadata" or NULL: what the errors are about */
   size_t name_at, name_end;     /* and its name, raw, still escaped */
   dn_error *err;
   dn_result code;
} dn__json;

/* at most 64 bytes of a name that is UTF-8, cut between characters, in quotes */
static void dn__put_name(dn__text *t, const unsigned char *name, size_t size)
{
   char part[65];
   size_t n = size < 64 ? size : 64;
   while (n < size && n > 0 && (name[n] & 0xc0) == 0x80) n--;
   memcpy(part, name, n);
   part[n] = 0;
   dn__put(t, "'");
   dn__put(t, part);
   dn__put(t, n < size ? "...'" : "'");
}
/* "tensor 'local.0.att_src': " when it is known; the caller goes on writing, then calls dn__json_end */
static dn__text dn__json_begin(const dn__json *j, char *line, size_t size)
{
   dn__text t = dn__text_of(line, size);
   if (j->kind) {
      dn__put(&t, j->kind);
      dn__put(&t, " ");
      dn__put_name(&t, j->file + j->name_at, j->name_end - j->name_at);
      dn__put(&t, ": ");
   }
   return t;
}
static int dn__json_end(dn__json *j, dn_result code, size_t at, const char *line)
{
   j->code = dn__fail(j->err, code, "tensor file", at, line);
   return 0;
}
static int dn__json_fail(dn__json *j, size_t at, const char *expected)
{
   static const char hex[] = "0123456789abcdef";
   char line[240], c[8];
   dn__text t = dn__json_begin(j, line, sizeof line);
   dn__put(&t, "expected ");
   dn__put(&t, expected);
   if (at >= j->end) dn__put(&t, ", found the end of the header");
   else {
      unsigned b = j->file[at];
      if (b > 0x20 && b < 0x7f) c[0] = '\'', c[1] = (char)b, c[2] = '\'', c[3] = 0;
      else c[0] = '0', c[1] = 'x', c[2] = hex[b >> 4], c[3] = hex[b & 15], c[4] = 0;
      dn__put(&t, ", found ");
      dn__put(&t, c);
   }
   dn__put(&t, " at byte ");
   dn__put_size(&t, at);
   return dn__json_end(j, DN_BAD_HEADER, at, line);
}

static void dn__json_space(dn__json *j)
{
   while (j->at < j->end) {
      unsigned c = j->file[j->at];
      if (c != ' ' && c != '\t' && c != '\n' && c != '\r') break;
      j->at++;
   }
}
static int dn__json_is(dn__json *j, unsigned char c) /* takes c when it is next */
{
   dn__json_space(j);
   if (j->at >= j->end || j->file[j->at] != c) return 0;
   j->at++;
   return 1;
}
static int dn__json_need(dn__json *j, unsigned char c, const char *expected)
{
   return dn__json_is(j, c) || dn__json_fail(j, j->at, expected);
}

/* bytes of the character at s, 0 when it is not UTF-8: too long a form, a surrogate, past U+10FFFF, cut */
static size_t dn__utf8(const unsigned char *s, size_t size)
{
   unsigned a = s[0], low = 0x80, high = 0xbf;
   size_t n = a < 0x80 ? 1 : a < 0xc2 ? 0 : a < 0xe0 ? 2 : a < 0xf0 ? 3 : a < 0xf5 ? 4 : 0, k;
   if (n < 2) return n;
   if (a == 0xe0) low = 0xa0;
   if (a == 0xed) high = 0x9f;
   if (a == 0xf0) low = 0x90;
   if (a == 0xf4) high = 0x8f;
   if (n > size || s[1] < low || s[1] > high) return 0;
   for (k = 2; k < n; k++)
      if ((s[k] & 0xc0) != 0x80) return 0;
   return n;
}
static int dn__json_hex(dn__json *j, uint32_t *out) /* four hex digits */
{
   uint32_t v = 0;
   int k;
   for (k = 0; k < 4; k++, j->at++) {
      unsigned c = j->at < j->end ? j->file[j->at] : 0u;
      if (c >= '0' && c <= '9') v = v << 4 | (c - '0');
      else if (c >= 'a' && c <= 'f') v = v << 4 | (c - 'a' + 10);
      else if (c >= 'A' && c <= 'F') v = v << 4 | (c - 'A' + 10);
      else return dn__json_fail(j, j->at, "four hex digits after \\u");
   }
   *out = v;
   return 1;
}
/* what a backslash stands for, as UTF-8 in b; at is on the backslash. 0 bytes: failed */
static size_t dn__json_escape(dn__json *j, unsigned char *b)
{
   size_t start = j->at++;
   unsigned c = j->at < j->end ? j->file[j->at] : 0u;
   uint32_t u = 0, v = 0;
   j->at++;
   switch (c) {
   case '"': case '\\': case '/': b[0] = (unsigned char)c; return 1;
   case 'b': b[0] = 8; return 1;
   case 'f': b[0] = 12; return 1;
   case 'n': b[0] = 10; return 1;
   case 'r': b[0] = 13; return 1;
   case 't': b[0] = 9; return 1;
   case 'u': break;
   default: return (size_t)dn__json_fail(j, start + 1, "one of \"\\/bfnrtu after a backslash");
   }
   if (!dn__json_hex(j, &u)) return 0;
   if (u == 0) return (size_t)dn__json_fail(j, start, "no NUL in a string");
   if (u >= 0xd800 && u < 0xe000) { /* one half of a pair: the other must follow */
      if (u >= 0xdc00 || j->at + 2 > j->end || j->file[j->at] != '\\' || j->file[j->at + 1] != 'u')
         return (size_t)dn__json_fail(j, start, "a pair of surrogates");
      j->at += 2;
      if (!dn__json_hex(j, &v)) return 0;
      if (v < 0xdc00 || v > 0xdfff) return (size_t)dn__json_fail(j, start, "a pair of surrogates");
      u = 0x10000 + ((u - 0xd800) << 10) + (v - 0xdc00);
   }
   if (u < 0x80) { b[0] = (unsigned char)u; return 1; }
   if (u < 0x800) {
      b[0] = (unsigned char)(0xc0 | u >> 6);
      b[1] = (unsigned char)(0x80 | (u & 63));
      return 2;
   }
   if (u < 0x10000) {
      b[0] = (unsigned char)(0xe0 | u >> 12);
      b[1] = (unsigned char)(0x80 | (u >> 6 & 63));
      b[2] = (unsigned char)(0x80 | (u & 63));
      return 3;
   }
   b[0] = (unsigned char)(0xf0 | u >> 18);
   b[1] = (unsigned char)(0x80 | (u >> 12 & 63));
   b[2] = (unsigned char)(0x80 | (u >> 6 & 63));
   b[3] = (unsigned char)(0x80 | (u & 63));
   return 4;
}
/* a string, unescaped: its first capacity - 1 bytes and a NUL go to out, its whole length to *length */
static int dn__json_string(dn__json *j, const char *expected, char *out, size_t capacity, size_t *length)
{
   size_t n = 0;
   if (!dn__json_need(j, '"', expected)) return 0;
   for (;;) {
      unsigned char b[4];
      size_t bytes, k;
      if (j->at >= j->end) return dn__json_fail(j, j->at, "a closing quote");
      if (j->file[j->at] == '"') break;
      if (j->file[j->at] < 0x20) return dn__json_fail(j, j->at, "no control character in a string");
      if (j->file[j->at] == '\\') {
         bytes = dn__json_escape(j, b);
         if (bytes == 0) return 0;
      } else {
         bytes = dn__utf8(j->file + j->at, j->end - j->at);
         if (bytes == 0) return dn__json_fail(j, j->at, "UTF-8");
         memcpy(b, j->file + j->at, bytes);
         j->at += bytes;
      }
      for (k = 0; k < bytes; k++, n++)
         if (capacity > 1 && n < capacity - 1) out[n] = (char)b[k];
   }
   j->at++;
   if (capacity) out[dn__min(n, capacity - 1)] = 0;
   *length = n;
   return 1;
}
/* a whole number >= 0 as JSON writes it: no sign, no leading zero, no fraction, no exponent */
static int dn__json_number(dn__json *j, size_t *out)
{
   size_t v = 0, start;
   dn__json_space(j);
   start = j->at;
   while (j->at < j->end && j->file[j->at] >= '0' && j->file[j->at] <= '9') {
      v = dn__add(dn__mul(v, 10), (size_t)(j->file[j->at] - '0')); /* saturates */
      j->at++;
   }
   if (j->at == start) return dn__json_fail(j, start, "a whole number, at least 0");
   if (j->file[start] == '0' && j->at > start + 1) return dn__json_fail(j, start, "a number without leading zeros");
   if (v == SIZE_MAX) return dn__json_fail(j, start, "a number that fits this machine");
   *out = v;
   return 1;
}

/* --- name tables */
static size_t dn__hash(const char *s)
{
   uint32_t h = 2166136261u; /* FNV-1a, then mixed so that the low bits depend on all */
   for (; *s; s++) h = (h ^ (unsigned char)*s) * 16777619u;
   h = (h ^ h >> 16) * 0x85ebca6bu;
   h = (h ^ h >> 13) * 0xc2b2ae35u;
   return h ^ h >> 16;
}
static size_t dn__names_slots(size_t count) /* a power of two, at least twice the count */
{
   size_t n = 2;
   while (n < 2 * count) n *= 2; /* count is below DN__HEADER_CAP / 6 */
   return n;
}
static const char *dn__name_at(const dn_tensors *t, const dn__names *names, size_t index)
{
   return names == &t->names ? t->entry[index].tensor.name : t->text + t->meta[index];
}
/* where name is or would go; *probes counts the slots looked at */
static uint32_t *dn__names_seek(const dn_tensors *t, const dn__names *names, const char *name, size_t *probes)
{
   size_t i = dn__hash(name) & names->mask;
   for (*probes = 1; names->slot[i] != 0; ++*probes) {
      if (strcmp(name, dn__name_at(t, names, names->slot[i] - 1)) == 0) break;
      i = (i + 1) & names->mask;
   }
   return &names->slot[i];
}
static int dn__names_add(dn__json *j, dn_tensors *t, dn__names *names, const char *name, size_t index)
{
   size_t probes;
   uint32_t *slot = dn__names_seek(t, names, name, &probes);
   if (*slot || probes > DN__PROBE_CAP) {
      char line[240];
      dn__text text = dn__json_begin(j, line, sizeof line);
      if (*slot) {
         dn__put(&text, "the name ");
         dn__put_name(&text, (const unsigned char *)name, strlen(name));
         dn__put(&text, " is there twice");
      } else dn__put(&text, "more than 256 names collide, expected names that were not made to");
      return dn__json_end(j, *slot ? DN_BAD_HEADER : DN_UNSUPPORTED, j->name_at, line);
   }
   *slot = (uint32_t)index + 1;
   return 1;
}

/* --- element types: all whole-byte types of the format are legal, those not listed there are not */
static int dn__st_format(const char *dtype, size_t *bytes)
{
   static const struct { char name[12]; unsigned char bytes, format; } types[] = {
      {"F32", 4, DN_ST_F32}, {"F16", 2, DN_ST_F16}, {"BF16", 2, DN_ST_BF16}, {"I32", 4, DN_ST_I32},
      {"F64", 8, DN_ST_OTHER}, {"I64", 8, DN_ST_OTHER}, {"U64", 8, DN_ST_OTHER}, {"C64", 8, DN_ST_OTHER},
      {"U32", 4, DN_ST_OTHER}, {"I16", 2, DN_ST_OTHER}, {"U16", 2, DN_ST_OTHER}, {"I8", 1, DN_ST_OTHER},
      {"U8", 1, DN_ST_OTHER}, {"BOOL", 1, DN_ST_OTHER}, {"F8_E5M2", 1, DN_ST_OTHER}, {"F8_E4M3", 1, DN_ST_OTHER},
      {"F8_E8M0", 1, DN_ST_OTHER}};
   size_t i;
   for (i = 0; i < sizeof types / sizeof types[0]; i++)
      if (strcmp(dtype, types[i].name) == 0) {
         *bytes = types[i].bytes;
         return types[i].format;
      }
   return -1;
}

typedef struct dn__need { size_t count, metas, text; } dn__need; /* what the first pass counts for the second */

/* {"dtype":...,"shape":...,"data_offsets":...} of the tensor j is about; data_size bytes of data follow the header */
static int dn__tensors_entry(dn__json *j, size_t data_size, dn_tensor *out, size_t *begin, size_t *bytes)
{
   static const char *const keys[3] = {"dtype", "shape", "data_offsets"};
   char small[16], dtype[16], line[240];
   size_t n, k, seen[3] = {0, 0, 0}, width = 0, product = 1, offsets[2] = {0, 0}, side;
   int zero = 0;
   dn__text t;
   memset(out, 0, sizeof *out);
   *begin = *bytes = 0;
   dtype[0] = 0;
   if (!dn__json_need(j, '{', "'{'")) return 0;
   do {
      size_t key_at;
      dn__json_space(j);
      key_at = j->at;
      if (!dn__json_string(j, "\"dtype\", \"shape\" or \"data_offsets\"", small, sizeof small, &n)) return 0;
      for (k = 0; k < 3 && strcmp(small, keys[k]) != 0; k++) {}
      if (k == 3) return dn__json_fail(j, key_at, "\"dtype\", \"shape\" or \"data_offsets\", not another key");
      if (seen[k]) {
         t = dn__json_begin(j, line, sizeof line);
         dn__put(&t, "key '");
         dn__put(&t, keys[k]);
         dn__put(&t, "' is there twice");
         return dn__json_end(j, DN_BAD_HEADER, key_at, line);
      }
      if (!dn__json_need(j, ':', "':'")) return 0;
      dn__json_space(j);
      seen[k] = j->at;
      if (k == 0) {
         if (!dn__json_string(j, "a string as dtype", dtype, sizeof dtype, &n)) return 0;
         out->format = dn__st_format(dtype, &width);
         if (out->format < 0) {
            t = dn__json_begin(j, line, sizeof line);
            dn__put(&t, "found dtype ");
            dn__put_name(&t, j->file + seen[0] + 1, j->at - seen[0] - 2);
            dn__put(&t, ", expected F32, F16, BF16, I32 or another whole-byte safetensors type");
            return dn__json_end(j, DN_BAD_TYPE, seen[0], line);
         }
      } else if (k == 1) {
         if (!dn__json_need(j, '[', "'[' before a shape")) return 0;
         if (!dn__json_is(j, ']')) {
            do {
               if (!dn__json_number(j, &side)) return 0;
               if (out->rank == DN__RANK_CAP) {
                  t = dn__json_begin(j, line, sizeof line);
                  dn__put(&t, "shape has more than 8 sides, expected at most 8");
                  return dn__json_end(j, DN_BAD_SHAPE, seen[1], line);
               }
               if (out->rank < 4) out->shape[out->rank] = side;
               out->rank++;
               if (side) product = dn__mul(product, side); /* a zero must not hide the overflow of the others */
               else zero = 1;
            } while (dn__json_is(j, ','));
            if (!dn__json_need(j, ']', "',' or ']' in a shape")) return 0;
         }
      } else {
         if (!dn__json_need(j, '[', "'[' before data_offsets") || !dn__json_number(j, &offsets[0]) ||
             !dn__json_need(j, ',', "',' between two data_offsets") || !dn__json_number(j, &offsets[1]) ||
             !dn__json_need(j, ']', "']' after two data_offsets")) return 0;
      }
   } while (dn__json_is(j, ','));
   if (!dn__json_need(j, '}', "',' or '}'")) return 0;
   for (k = 0; k < 3; k++)
      if (!seen[k]) {
         t = dn__json_begin(j, line, sizeof line);
         dn__put(&t, "key '");
         dn__put(&t, keys[k]);
         dn__put(&t, "' is missing");
         return dn__json_end(j, DN_BAD_HEADER, j->at, line);
      }

   /* dtype, shape and range must agree: product x width = end - begin <= data_size, nothing wrapping on the way */
   t = dn__json_begin(j, line, sizeof line);
   if (dn__mul(product, width) >= SIZE_MAX / 2) {
      dn__put(&t, "the product of the shape does not fit this machine");
      return dn__json_end(j, DN_BAD_SHAPE, seen[1], line);
   }
   out->count = zero ? 0 : product;
   *bytes = dn__mul(out->count, width);
   *begin = offsets[0];
   if (offsets[0] > offsets[1] || offsets[1] > data_size) {
      dn__put(&t, "found data_offsets ");
      dn__put_size(&t, offsets[0]);
      dn__put(&t, " to ");
      dn__put_size(&t, offsets[1]);
      dn__put(&t, ", expected rising and at most ");
      dn__put_size(&t, data_size);
      dn__put(&t, " (the bytes after the header)");
      return dn__json_end(j, DN_BAD_LAYOUT, seen[2], line);
   }
   if (offsets[1] - offsets[0] != *bytes) {
      dn__put(&t, "data_offsets span ");
      dn__put_size(&t, offsets[1] - offsets[0]);
      dn__put(&t, " bytes, expected ");
      dn__put_size(&t, *bytes);
      dn__put(&t, " for ");
      dn__put_size(&t, out->count);
      dn__put(&t, " elements of ");
      dn__put(&t, dtype);
      return dn__json_end(j, DN_BAD_LAYOUT, seen[2], line);
   }
   if (out->rank > 4) out->format = DN_ST_OTHER;
   return 1;
}

/* {"key":"text", ...}; into t when it is not NULL, counted in need either way */
static int dn__tensors_metadata(dn__json *j, dn_tensors *t, dn__need *need)
{
   if (!dn__json_need(j, '{', "'{' after \"__metadata__\"")) return 0;
   if (dn__json_is(j, '}')) return 1;
   do {
      size_t n, key = need->text;
      j->kind = NULL;
      dn__json_space(j);
      j->name_at = j->at + 1;
      if (!dn__json_string(j, "a metadata key in quotes", t ? t->text + key : NULL, t ? t->text_size - key : 0, &n)) return 0;
      need->text += n + 1;
      j->kind = "metadata";
      j->name_end = j->at - 1;
      if (!dn__json_need(j, ':', "':'") ||
          !dn__json_string(j, "a string", t ? t->text + need->text : NULL, t ? t->text_size - need->text : 0, &n)) return 0;
      need->text += n + 1;
      if (t) {
         t->meta[need->metas] = (uint32_t)key;
         if (!dn__names_add(j, t, &t->keys, t->text + key, need->metas)) return 0;
      }
      need->metas++;
   } while (dn__json_is(j, ','));
   return dn__json_need(j, '}', "',' or '}'");
}

/* One pass over the header. t NULL: check everything that one tensor can tell, and count. Else the same again, and
   write: the caller sized t by the counts of the first pass over the same bytes. */
static dn_result dn__tensors_scan(const unsigned char *file, size_t size, dn_tensors *t, dn__need *need, dn_error *err)
{
   static const char where[] = "tensor file", meta[] = "__metadata__";
   dn__json j;
   uint64_t length = 0;
   size_t data_size, k, n, begin, bytes, metadata_seen = 0;
   char small[16];
   memset(need, 0, sizeof *need);
   if (size < 8) return dn__fail_sizes(err, DN_TRUNCATED, where, size, "found ", size, " bytes, expected at least ", 8, NULL);
   for (k = 8; k-- > 0;) length = length << 8 | file[k];
   if (length < 2 || length > DN__HEADER_CAP) {
      char line[240];
      dn__text text = dn__text_of(line, sizeof line);
      dn__put(&text, "found a header length of ");
      dn__put_u64(&text, length);
      dn__put(&text, ", expected 2 to 100000000");
      return dn__fail(err, DN_BAD_HEADER, where, 0, line);
   }
   if (length > size - 8)
      return dn__fail_sizes(err, DN_TRUNCATED, where, 0, "found a header length of ", (size_t)length,
                            ", expected at most the ", size - 8, " bytes after it");
   memset(&j, 0, sizeof j);
   j.file = file;
   j.at = 8;
   j.end = 8 + (size_t)length;
   j.err = err;
   data_size = size - j.end;
   if (file[8] != '{') {
      (void)dn__json_fail(&j, 8, "'{' as the header's first byte");
      return j.code;
   }
   j.at++;
   if (!dn__json_is(&j, '}')) {
      do {
         char *name = t ? t->text + need->text : small;
         dn_tensor tensor;
         j.kind = NULL;
         dn__json_space(&j);
         j.name_at = j.at + 1;
         if (!dn__json_string(&j, "a tensor name in quotes", name, t ? t->text_size - need->text : sizeof small, &n))
            return j.code;
         j.name_end = j.at - 1;
         if (n == sizeof meta - 1 && strcmp(name, meta) == 0) {
            if (metadata_seen)
               return dn__fail(err, DN_BAD_HEADER, where, j.name_at, "the key '__metadata__' is there twice");
            metadata_seen = 1;
            if (!dn__json_need(&j, ':', "':'") || !dn__tensors_metadata(&j, t, need)) return j.code;
            continue;
         }
         j.kind = "tensor";
         need->text += n + 1;
         if (t && !dn__names_add(&j, t, &t->names, name, need->count)) return j.code;
         if (!dn__json_need(&j, ':', "':'") || !dn__tensors_entry(&j, data_size, &tensor, &begin, &bytes)) return j.code;
         if (t) {
            tensor.name = name;
            tensor.data = t->data + begin;
            t->entry[need->count].tensor = tensor;
            t->entry[need->count].bytes = bytes;
         }
         need->count++;
      } while (dn__json_is(&j, ','));
      j.kind = NULL;
      if (!dn__json_need(&j, '}', "',' or '}'")) return j.code;
   }
   dn__json_space(&j);
   if (j.at != j.end) {
      (void)dn__json_fail(&j, j.at, "only white space after the header's '}'");
      return j.code;
   }
   return DN_OK;
}

/* --- the ranges, sorted by where they begin, must follow each other from 0 to the end of the data: that alone rules
   out overlaps, shared ranges, holes and data that no tensor owns. Heap sort: n log n for every input. */
static int dn__range_before(const dn_tensors *t, uint32_t a, uint32_t b)
{
   const dn__entry *x = &t->entry[a], *y = &t->entry[b];
   if (x->tensor.data != y->tensor.data) return x->tensor.data < y->tensor.data;
   return x->bytes < y->bytes; /* empty tensors come first where they stand */
}
static void dn__range_sink(const dn_tensors *t, size_t at, size_t count)
{
   uint32_t *o = t->order, moved = o[at];
   size_t child;
   for (; (child = 2 * at + 1) < count; at = child) {
      if (child + 1 < count && dn__range_before(t, o[child], o[child + 1])) child++;
      if (!dn__range_before(t, moved, o[child])) break;
      o[at] = o[child];
   }
   o[at] = moved;
}
static dn_result dn__tensors_layout(const dn_tensors *t, const unsigned char *file, dn_error *err)
{
   size_t i, end = 0, header = (size_t)(t->data - file);
   uint32_t last;
   const dn__entry *before = NULL;
   char line[240];
   dn__text text = dn__text_of(line, sizeof line);
   for (i = 0; i < t->count; i++) t->order[i] = (uint32_t)i;
   for (i = t->count / 2; i-- > 0;) dn__range_sink(t, i, t->count);
   for (i = t->count; i-- > 1;) {
      last = t->order[i];
      t->order[i] = t->order[0];
      t->order[0] = last;
      dn__range_sink(t, 0, i);
   }
   for (i = 0; i < t->count; i++) {
      const dn__entry *e = &t->entry[t->order[i]];
      size_t begin = (size_t)(e->tensor.data - t->data);
      if (begin != end) {
         dn__put(&text, "tensor ");
         dn__put_name(&text, (const unsigned char *)e->tensor.name, strlen(e->tensor.name));
         dn__put(&text, ": data begins at ");
         dn__put_size(&text, begin);
         dn__put(&text, ", expected ");
         dn__put_size(&text, end);
         dn__put(&text, before ? ", where the data ends of " : ", the first byte");
         if (before) dn__put_name(&text, (const unsigned char *)before->tensor.name, strlen(before->tensor.name));
         return dn__fail(err, DN_BAD_LAYOUT, "tensor file", header + begin, line);
      }
      end = begin + e->bytes; /* both checked against data_size */
      before = e;
   }
   if (end != t->data_size)
      return dn__fail_sizes(err, DN_BAD_LAYOUT, "tensor file", header + end, "found ", t->data_size,
                            " bytes of data, expected the ", end, " that the tensors cover");
   return DN_OK;
}

/* one layout for the query and for the table itself; t's pointers stay NULL while measuring */
static dn_tensors *dn__tensors_lay(dn__arena *a, const dn__need *need, dn_tensors *t)
{
   dn_tensors *self = (dn_tensors *)dn__take(a, 1, sizeof *self);
   memset(t, 0, sizeof *t);
   t->count = need->count;
   t->metas = need->metas;
   t->names.mask = dn__names_slots(need->count) - 1;
   t->keys.mask = dn__names_slots(need->metas) - 1;
   t->text_size = need->text + sizeof "__metadata__"; /* that key passes through and is overwritten */
   t->entry = (dn__entry *)dn__take(a, t->count, sizeof *t->entry);
   t->order = (uint32_t *)dn__take(a, t->count, sizeof *t->order);
   t->meta = (uint32_t *)dn__take(a, t->metas, sizeof *t->meta);
   t->names.slot = (uint32_t *)dn__take(a, t->names.mask + 1, sizeof *t->names.slot);
   t->keys.slot = (uint32_t *)dn__take(a, t->keys.mask + 1, sizeof *t->keys.slot);
   t->text = (char *)dn__take(a, t->text_size, 1);
   return self;
}

DN_API dn_result dn_tensors_size(const void *file, size_t size, size_t *bytes, dn_error *err)
{
   dn__need need;
   dn_tensors t;
   dn__arena a = dn__arena_of(NULL, 0);
   dn_result r;
   DN_ASSERT((file || size == 0) && bytes);
   *bytes = 0;
   r = dn__tensors_scan((const unsigned char *)file, size, NULL, &need, err);
   if (r != DN_OK) return r;
   (void)dn__tensors_lay(&a, &need, &t);
   *bytes = dn__gauge(&a);
   return DN_OK;
}
DN_API dn_result dn_tensors_open(const void *file, size_t size, void *memory, size_t bytes, dn_tensors **tensors, dn_error *err)
{
   const unsigned char *f = (const unsigned char *)file;
   dn__need need;
   dn_tensors t, *self;
   dn__arena a = dn__arena_of(memory, bytes);
   dn_result r;
   DN_ASSERT((file || size == 0) && tensors);
   *tensors = NULL;
   r = dn__tensors_scan(f, size, NULL, &need, err);
   if (r != DN_OK) return r;
   self = dn__tensors_lay(&a, &need, &t);
   if (!memory || dn__gauge(&a) > bytes)
      return dn__fail_sizes(err, DN_TOO_SMALL, "tensor file", SIZE_MAX, "found ", memory ? bytes : 0,
                            " bytes of memory, expected ", dn__gauge(&a), NULL);
   memset(t.names.slot, 0, (t.names.mask + 1) * sizeof *t.names.slot);
   memset(t.keys.slot, 0, (t.keys.mask + 1) * sizeof *t.keys.slot);
   {
      size_t header = 8, k; /* the length was checked by the scan */
      for (k = 0; k < 4; k++) header += (size_t)f[k] << (8 * k);
      t.data = f + header;
      t.data_size = size - header;
   }
   r = dn__tensors_scan(f, size, &t, &need, err);
   if (r != DN_OK) return r;
   DN_ASSERT(need.count == t.count && need.metas == t.metas); /* else the file changed under our hands */
   r = dn__tensors_layout(&t, f, err);
   if (r != DN_OK) return r;
   *self = t;
   *tensors = self;
   return DN_OK;
}
DN_API size_t dn_tensors_count(const dn_tensors *t) { return t->count; }
DN_API const dn_tensor *dn_tensors_at(const dn_tensors *t, size_t index)
{
   DN_ASSERT(index < t->count);
   return &t->entry[index].tensor;
}
DN_API const dn_tensor *dn_tensors_find(const dn_tensors *t, const char *name)
{
   size_t probes;
   uint32_t slot = *dn__names_seek(t, &t->names, name, &probes);
   return slot ? &t->entry[slot - 1].tensor : NULL;
}
DN_API const char *dn_tensors_meta(const dn_tensors *t, const char *key)
{
   size_t probes;
   uint32_t slot = *dn__names_seek(t, &t->keys, key, &probes);
   const char *found = slot ? t->text + t->meta[slot - 1] : NULL;
   return found ? found + strlen(found) + 1 : NULL;
}

/* --- elements, byte by byte: any alignment, any byte order of the machine. Halves are widened with integers, so that
   no floating-point mode (flush to zero, rounding) can touch them; the bits of a NaN pass through. */
static uint32_t dn__half_bits(unsigned h)
{
   uint32_t sign = (uint32_t)(h & 0x8000u) << 16, exponent = h >> 10 & 31u, fraction = h & 0x3ffu;
   if (exponent == 31) return sign | 0x7f800000u | fraction << 13; /* inf, NaN */
   if (exponent == 0) {
      if (fraction == 0) return sign;
      for (exponent = 1; !(fraction & 0x400u); exponent--) fraction <<= 1; /* denormal: 2^-24 fraction; wraps below 0 */
      fraction &= 0x3ffu;
   }
   return sign | (exponent + 112u) << 23 | fraction << 13; /* 112 = 127 - 15 */
}
DN_API void dn_tensor_floats(const dn_tensor *t, size_t from, size_t count, float *out)
{
   const unsigned char *p;
   uint32_t u;
   size_t i;
   DN_ASSERT(from <= t->count && count <= t->count - from && t->format != DN_ST_OTHER);
   switch (t->format) {
   case DN_ST_F32:
      for (i = 0, p = t->data + from * 4; i < count; i++, p += 4) {
         u = (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
         memcpy(out + i, &u, 4);
      }
      break;
   case DN_ST_F16:
      for (i = 0, p = t->data + from * 2; i < count; i++, p += 2) {
         u = dn__half_bits(p[0] | (unsigned)p[1] << 8);
         memcpy(out + i, &u, 4);
      }
      break;
   case DN_ST_BF16:
      for (i = 0, p = t->data + from * 2; i < count; i++, p += 2) {
         u = (uint32_t)p[0] << 16 | (uint32_t)p[1] << 24;
         memcpy(out + i, &u, 4);
      }
      break;
   case DN_ST_I32: /* exact up to 2^24, rounded beyond */
      for (i = 0; i < count; i++) {
         int32_t v;
         dn_tensor_ints(t, from + i, 1, &v);
         out[i] = (float)v;
      }
      break;
   default: memset(out, 0, count * sizeof *out);
   }
}
DN_API void dn_tensor_ints(const dn_tensor *t, size_t from, size_t count, int32_t *out)
{
   const unsigned char *p = t->data + from * 4;
   size_t i;
   DN_ASSERT(from <= t->count && count <= t->count - from && t->format == DN_ST_I32);
   for (i = 0; i < count; i++, p += 4) {
      uint32_t u = (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
      memcpy(out + i, &u, 4);
   }
}


/* ===================================================================================== >>mesh
   in       render vertices (V), triangles (T,3)     out   nodes (N), one-rings (CSR), corners (CSR), normals (N,3)
   touches  the scratch passed in, nothing else: no allocation, no I/O, no statics
   spec     section 1 decides; all of it is expected linear time, hubs and fans included. One exception: vertices heaped
            on one place with weights all apart are compared pair by pair
   read     dn_weld, then dn_graph_build */

/* --- names: what two rigs of one character agree on is the part after the exporter's prefix */
static const char *dn__name_core(const char *name) /* "mixamorig:Hips", "Armature|Hips" -> "Hips" */
{
   const char *core = name;
   for (; *name; name++)
      if (*name == ':' || *name == '|') core = name + 1;
   return core;
}
static int dn__name_equal(const char *a, const char *b) { return strcmp(a, b) == 0; } /* take the cores first */

/* --- weld. A hash grid from place to the nodes there. With distance 0 a "cell" is one exact position; else cells are
   a hair wider than the distance, so that everything in reach lies in the 27 cells around a vertex. */
typedef struct dn__weld_grid {
   uint32_t *head, *tail; /* (buckets) first and last node of each bucket's chain, DN__NONE when empty */
   uint32_t *next;        /* (N) chains grow at the tail: ascending node order */
   size_t mask;           /* buckets - 1 */
} dn__weld_grid;
#define DN__NONE 0xffffffffu

static size_t dn__weld_buckets(size_t vertices) /* a power of two, at least twice the vertices */
{
   size_t n = 16;
   while (n < vertices && n < SIZE_MAX / 8) n *= 2;
   return n * 2;
}
static dn__weld_grid dn__weld_layout(dn__arena *a, size_t vertices)
{
   dn__weld_grid w;
   size_t buckets = dn__weld_buckets(vertices);
   w.head = (uint32_t *)dn__take(a, buckets, sizeof(uint32_t));
   w.tail = (uint32_t *)dn__take(a, buckets, sizeof(uint32_t));
   w.next = (uint32_t *)dn__take(a, vertices, sizeof(uint32_t));
   w.mask = buckets - 1;
   return w;
}
static double dn__floor(double x) /* beyond 2^52 every double is whole already; NaN passes through */
{
   if (DN_FABS(x) < 4503599627370496.0) {
      double t = (double)(int64_t)x;
      return t > x ? t - 1.0 : t;
   }
   return x;
}
static size_t dn__hash3(const double c[3]) /* numbers, not bits: -0 hashes as +0 */
{
   uint64_t h = 0x9e3779b97f4a7c15u;
   int k;
   for (k = 0; k < 3; k++) {
      double v = c[k] == 0.0 ? 0.0 : c[k];
      uint64_t bits;
      memcpy(&bits, &v, 8);
      h = (h ^ bits) * 0xff51afd7ed558ccdu;
      h ^= h >> 32;
   }
   h *= 0xc4ceb9fe1a85ec53u;
   return (size_t)(h ^ (h >> 29));
}
/* total weight that one row gives a joint; a joint may be listed more than once */
static double dn__weight_of(const uint32_t *joint, const float *weight, size_t influences, uint32_t wanted)
{
   double sum = 0.0;
   size_t i;
   for (i = 0; i < influences; i++)
      if (joint[i] == wanted) sum += (double)weight[i];
   return sum;
}
/* max over joints |a - b| <= 0.05: every joint that matters is listed in one of the two rows */
static int dn__weights_alike(const uint32_t *ja, const float *wa, const uint32_t *jb, const float *wb, size_t influences)
{
   size_t i;
   for (i = 0; i < influences; i++) {
      double a = dn__weight_of(ja, wa, influences, ja[i]) - dn__weight_of(jb, wb, influences, ja[i]);
      double b = dn__weight_of(ja, wa, influences, jb[i]) - dn__weight_of(jb, wb, influences, jb[i]);
      if (!(DN_FABS(a) <= 0.05) || !(DN_FABS(b) <= 0.05)) return 0;
   }
   return 1;
}

DN_API size_t dn_weld_scratch(size_t vertices)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn__weld_layout(&a, vertices);
   return dn__gauge(&a);
}
DN_API size_t dn_weld(const float *positions, size_t vertices, const uint32_t *joints, const float *weights,
                      size_t influences, float distance, uint32_t *node_of_vertex, uint32_t *first_vertex, size_t *apart,
                      void *scratch)
{
   dn__arena arena = dn__arena_of(scratch, SIZE_MAX);
   dn__weld_grid grid = dn__weld_layout(&arena, vertices);
   double reach = distance > 0.0f ? (double)distance : 0.0;
   double cell = reach * 1.0001; /* the hair covers the rounding of position / cell */
   size_t nodes = 0, left_apart = 0, v;
   DN_ASSERT(vertices < DN__NONE && scratch && node_of_vertex && first_vertex);
   memset(grid.head, 0xff, (grid.mask + 1) * sizeof *grid.head);

   for (v = 0; v < vertices; v++) {
      const float *p = positions + 3 * v;
      double home[3];
      uint32_t best = DN__NONE;
      int seen_apart = 0, k, around = reach > 0.0 ? 27 : 1;
      size_t home_bucket;
      for (k = 0; k < 3; k++) home[k] = reach > 0.0 ? dn__floor((double)p[k] / cell) : (double)p[k];
      home_bucket = dn__hash3(home) & grid.mask;

      for (k = 0; k < around; k++) {
         size_t bucket = home_bucket;
         uint32_t n;
         if (around > 1) {
            double c[3];
            c[0] = home[0] + (double)(k % 3 - 1);
            c[1] = home[1] + (double)(k / 3 % 3 - 1);
            c[2] = home[2] + (double)(k / 9 - 1);
            bucket = dn__hash3(c) & grid.mask;
         }
         /* the earliest node of all cells wins, so a chain is done once it has passed the best so far */
         for (n = grid.head[bucket]; n != DN__NONE && n < best; n = grid.next[n]) {
            size_t u = first_vertex[n];
            const float *q = positions + 3 * u;
            double x = (double)p[0] - (double)q[0], y = (double)p[1] - (double)q[1], z = (double)p[2] - (double)q[2];
            if (!(x * x + y * y + z * z <= reach * reach)) continue;
            if (!weights || dn__weights_alike(joints + v * influences, weights + v * influences, joints + u * influences,
                                              weights + u * influences, influences))
               best = n;
            else seen_apart = 1;
         }
      }
      if (best == DN__NONE) { /* starts a node */
         best = (uint32_t)nodes++;
         first_vertex[best] = (uint32_t)v;
         grid.next[best] = DN__NONE;
         if (grid.head[home_bucket] == DN__NONE) grid.head[home_bucket] = best;
         else grid.next[grid.tail[home_bucket]] = best;
         grid.tail[home_bucket] = best;
         left_apart += (size_t)seen_apart;
      }
      node_of_vertex[v] = best;
   }
   if (apart) *apart = left_apart;
   return nodes;
}

/* --- one-rings. Directed edges are dropped into rows by their source, in any order and with repeats; transposing
   those rows visits sources in ascending order, and as every edge is there both ways the transpose IS the graph,
   sorted: no comparison sort, so a hub with a million spokes costs no more than a million edges elsewhere. */
DN_API size_t dn_graph_scratch(size_t nodes, size_t triangles)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn__take(&a, dn__add(nodes, 1), sizeof(uint32_t));
   dn__take(&a, dn__mul(triangles, 6), sizeof(uint32_t));
   return dn__gauge(&a);
}
DN_API void dn_graph_build(const uint32_t *triangle, size_t triangles, size_t nodes, uint32_t *first, uint32_t *next,
                           dn_graph *g, void *scratch)
{
   dn__arena arena = dn__arena_of(scratch, SIZE_MAX);
   uint32_t *cursor = (uint32_t *)dn__take(&arena, nodes + 1, sizeof(uint32_t));
   uint32_t *loose = (uint32_t *)dn__take(&arena, 6 * triangles, sizeof(uint32_t)); /* neighbours, unsorted, repeated */
   uint32_t total = 0;
   size_t t, i, from, e;
   int c;
   DN_ASSERT(nodes < DN__NONE && triangles < DN__NONE / 6);

   memset(first, 0, (nodes + 1) * sizeof *first);
   for (t = 0; t < triangles; t++)
      for (c = 0; c < 3; c++) {
         uint32_t a = triangle[3 * t + (size_t)c], b = triangle[3 * t + (size_t)(c == 2 ? 0 : c + 1)];
         DN_ASSERT(a < nodes);
         if (a != b) first[a]++, first[b]++;
      }
   for (i = 0; i < nodes; i++) { /* counts -> row starts */
      uint32_t count = first[i];
      cursor[i] = first[i] = total;
      total += count;
   }
   first[nodes] = total;
   for (t = 0; t < triangles; t++)
      for (c = 0; c < 3; c++) {
         uint32_t a = triangle[3 * t + (size_t)c], b = triangle[3 * t + (size_t)(c == 2 ? 0 : c + 1)];
         if (a != b) loose[cursor[a]++] = b, loose[cursor[b]++] = a;
      }
   memcpy(cursor, first, nodes * sizeof *first);
   for (i = 0; i < nodes; i++) /* transpose; a repeat follows its twin directly */
      for (e = first[i]; e < first[i + 1]; e++) next[cursor[loose[e]]++] = (uint32_t)i;

   total = 0; /* drop the repeats, rows sliding down in place */
   from = 0;
   for (i = 0; i < nodes; i++) {
      size_t end = first[i + 1];
      uint32_t start = total;
      for (e = from; e < end; e++)
         if (total == start || next[total - 1] != next[e]) next[total++] = next[e];
      first[i] = start;
      from = end;
   }
   first[nodes] = total;
   g->nodes = nodes;
   g->first = first;
   g->next = next;
}

static size_t dn__isolated_nodes(const dn_graph *g)
{
   size_t i, count = 0;
   for (i = 0; i < g->nodes; i++) count += g->first[i] == g->first[i + 1];
   return count;
}
/* connected components by flooding; label (N): which component, numbered by first node; queue (N); returns how many */
static size_t dn__graph_components(const dn_graph *g, uint32_t *label, uint32_t *queue)
{
   size_t i, count = 0;
   memset(label, 0xff, g->nodes * sizeof *label);
   for (i = 0; i < g->nodes; i++) {
      size_t head = 0, tail = 0;
      if (label[i] != DN__NONE) continue;
      label[i] = (uint32_t)count;
      queue[tail++] = (uint32_t)i;
      while (head < tail) {
         uint32_t n = queue[head++], e;
         for (e = g->first[n]; e < g->first[n + 1]; e++) {
            uint32_t m = g->next[e];
            if (label[m] == DN__NONE) label[m] = (uint32_t)count, queue[tail++] = m;
         }
      }
      count++;
   }
   return count;
}

/* --- normals: n_i = sum over the triangles at i of (b - a) x (c - a), made unit. The cross product is twice the
   area long, which is the weighting. Scattering by triangle and gathering by node add in the same order. */
static void dn__triangle_cross(const float *positions, const uint32_t *t, float n[3])
{
   const float *a = positions + 3 * (size_t)t[0], *b = positions + 3 * (size_t)t[1], *c = positions + 3 * (size_t)t[2];
   float ux = b[0] - a[0], uy = b[1] - a[1], uz = b[2] - a[2];
   float vx = c[0] - a[0], vy = c[1] - a[1], vz = c[2] - a[2];
   n[0] = uy * vz - uz * vy;
   n[1] = uz * vx - ux * vz;
   n[2] = ux * vy - uy * vx;
}
static void dn__unit_normal(float n[3])
{
   float length = DN_SQRTF(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
   float scale = length >= 1e-18f && dn__finite(length) ? 1.0f / length : 0.0f;
   int k;
   for (k = 0; k < 3; k++) n[k] = scale > 0.0f ? n[k] * scale : 0.0f; /* not x * 0: NaN must end here */
}
DN_API void dn_normals(const float *positions, size_t nodes, const uint32_t *triangle, size_t triangles, float *normals)
{
   size_t t, i;
   memset(normals, 0, 3 * nodes * sizeof *normals);
   for (t = 0; t < triangles; t++) {
      float n[3];
      int c;
      dn__triangle_cross(positions, triangle + 3 * t, n);
      for (c = 0; c < 3; c++) {
         float *to = normals + 3 * (size_t)triangle[3 * t + (size_t)c];
         to[0] += n[0];
         to[1] += n[1];
         to[2] += n[2];
      }
   }
   for (i = 0; i < nodes; i++) dn__unit_normal(normals + 3 * i);
}
/* which triangles meet at each node, ascending: corner_first (nodes+1), corner_tri (3T) */
static void dn__corners_build(const uint32_t *triangle, size_t triangles, size_t nodes, uint32_t *corner_first,
                              uint32_t *corner_tri)
{
   uint32_t total = 0;
   size_t i;
   DN_ASSERT(triangles < DN__NONE / 3);
   memset(corner_first, 0, (nodes + 1) * sizeof *corner_first);
   for (i = 0; i < 3 * triangles; i++) corner_first[triangle[i]]++;
   for (i = 0; i < nodes; i++) { /* counts -> row starts */
      uint32_t count = corner_first[i];
      corner_first[i] = total;
      total += count;
   }
   for (i = 0; i < 3 * triangles; i++) corner_tri[corner_first[triangle[i]]++] = (uint32_t)(i / 3);
   for (i = nodes; i > 0; i--) corner_first[i] = corner_first[i - 1]; /* each start had moved to its row's end */
   corner_first[0] = 0;
}
/* nodes begin..end of dn_normals, the same bits, writing nothing but their own rows */
static void dn__normals_range(const float *positions, const uint32_t *triangle, const uint32_t *corner_first,
                              const uint32_t *corner_tri, size_t begin, size_t end, float *normals)
{
   size_t i, e;
   for (i = begin; i < end; i++) {
      float sum[3] = { 0.0f, 0.0f, 0.0f };
      for (e = corner_first[i]; e < corner_first[i + 1]; e++) {
         float n[3];
         dn__triangle_cross(positions, triangle + 3 * (size_t)corner_tri[e], n);
         sum[0] += n[0];
         sum[1] += n[1];
         sum[2] += n[2];
      }
      dn__unit_normal(sum);
      memcpy(normals + 3 * i, sum, sizeof sum);
   }
}
/* The same for what the network reads, in double. low (nodes,3) holds what the floats of positions leave of more
   exact ones: neighbours lie close together, so it carries most digits of a short edge, and in a folded fan the
   cross products nearly cancel. On a body of 10,242 nodes plain floats were off by up to 4e-5, this by 1e-7. */
static void dn__normals_fine_range(const float *positions, const float *low, const uint32_t *triangle,
                                   const uint32_t *corner_first, const uint32_t *corner_tri, size_t begin, size_t end,
                                   float *normals)
{
   size_t i, e, k;
   for (i = begin; i < end; i++) {
      double sum[3] = { 0.0, 0.0, 0.0 }, length, scale;
      for (e = corner_first[i]; e < corner_first[i + 1]; e++) {
         const uint32_t *t = triangle + 3 * (size_t)corner_tri[e];
         size_t a = 3 * (size_t)t[0], b = 3 * (size_t)t[1], c = 3 * (size_t)t[2];
         double u[3], v[3];
         for (k = 0; k < 3; k++) {
            double p = (double)positions[a + k] + (double)low[a + k];
            u[k] = (double)positions[b + k] + (double)low[b + k] - p;
            v[k] = (double)positions[c + k] + (double)low[c + k] - p;
         }
         sum[0] += u[1] * v[2] - u[2] * v[1];
         sum[1] += u[2] * v[0] - u[0] * v[2];
         sum[2] += u[0] * v[1] - u[1] * v[0];
      }
      length = DN_SQRT(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]);
      scale = length >= 1e-18 && dn__finite((float)length) ? 1.0 / length : 0.0;
      for (k = 0; k < 3; k++) normals[3 * i + k] = scale > 0.0 ? (float)(sum[k] * scale) : 0.0f;
   }
}

/* ===================================================================================== >>skin
   in       rest points (V,3), joints and weights (V,I), palette (S,12)     out   skinned points, rows (N,D)
   touches  the output range it is given, nothing else: ranges may run on different threads
   paper    T 2.1 (LBS), T 2.2 (DQS, after Kavan et al. 2007), T 3.8 (Rodrigues), T 3.9 (relative), C 4.4 (distance)
   spec     sections 2 and 3 decide
   matrices 3x4 are row-major: m[4*r + c], translation in column 3; 3x3 are m[3*r + c]; column vectors
   read     dn_lbs, dn_dqs, then the dn__rows_* writers */

/* --- matrices */
static void dn__load_matrix(const float *src, dn_matrix layout, float out[12])
{
   int r, c;
   switch (layout) {
   case DN_3X4_ROWS:
   case DN_4X4_ROWS: memcpy(out, src, 12 * sizeof *out); break; /* the fourth row, 0 0 0 1, is not needed */
   case DN_3X4_COLUMNS:
      for (r = 0; r < 3; r++)
         for (c = 0; c < 4; c++) out[4 * r + c] = src[3 * c + r];
      break;
   case DN_4X4_COLUMNS:
   default:
      for (r = 0; r < 3; r++)
         for (c = 0; c < 4; c++) out[4 * r + c] = src[4 * c + r];
      break;
   }
}
static size_t dn__matrix_floats(dn_matrix layout) { return layout == DN_3X4_ROWS || layout == DN_3X4_COLUMNS ? 12 : 16; }
static void dn__part3x3(const float m[12], float out[9])
{
   int r;
   for (r = 0; r < 3; r++) memcpy(out + 3 * r, m + 4 * r, 3 * sizeof *out);
}
static int dn__finite12(const float m[12])
{
   int k, ok = 1;
   for (k = 0; k < 12; k++) ok &= dn__finite(m[k]);
   return ok;
}
static void dn__mul3x4(const float a[12], const float b[12], float out[12]) /* a b, both with last row 0 0 0 1 */
{
   int r, c;
   for (r = 0; r < 3; r++)
      for (c = 0; c < 4; c++)
         out[4 * r + c] = a[4 * r] * b[c] + a[4 * r + 1] * b[4 + c] + a[4 * r + 2] * b[8 + c] + (c == 3 ? a[4 * r + 3] : 0.0f);
}
static void dn__transform(const float m[12], const float p[3], float out[3]) /* m [p; 1] */
{
   float x = p[0], y = p[1], z = p[2];
   out[0] = m[0] * x + m[1] * y + m[2] * z + m[3];
   out[1] = m[4] * x + m[5] * y + m[6] * z + m[7];
   out[2] = m[8] * x + m[9] * y + m[10] * z + m[11];
}

DN_API void dn_rodrigues(const float axis_angle[3], float rotation[9])
{
   double x = (double)axis_angle[0], y = (double)axis_angle[1], z = (double)axis_angle[2];
   double square = x * x + y * y + z * z, angle = DN_SQRT(square);
   double s = 1.0, c = 0.5; /* their limits at angle 0: R = I + K + K K / 2 */
   if (angle > 1e-9) {
      double half = (double)DN_SINF((float)(angle * 0.5));
      s = (double)DN_SINF((float)angle) / angle;
      c = 2.0 * half * half / square; /* 1 - cos without its cancellation */
   }
   /* R = I + s K + c K K,  K = [a]x,  K K = a a^T - |a|^2 I                                              T 3.8 */
   rotation[0] = (float)(1.0 + c * (x * x - square));
   rotation[4] = (float)(1.0 + c * (y * y - square));
   rotation[8] = (float)(1.0 + c * (z * z - square));
   rotation[1] = (float)(c * x * y - s * z);
   rotation[3] = (float)(c * x * y + s * z);
   rotation[2] = (float)(c * x * z + s * y);
   rotation[6] = (float)(c * x * z - s * y);
   rotation[5] = (float)(c * y * z - s * x);
   rotation[7] = (float)(c * y * z + s * x);
}
/* In double: two float columns that are parallel must leave nothing, not rounding noise that looks like a direction. */
DN_API void dn_orthonormalise(const float m[9], float rotation[9])
{
   double x[3], y[3], z[3], length = 0.0, along = 0.0, rest = 0.0;
   int r, ok;
   for (r = 0; r < 3; r++) {
      x[r] = (double)m[3 * r];
      y[r] = (double)m[3 * r + 1];
      length += x[r] * x[r];
   }
   length = DN_SQRT(length);
   ok = length >= 1e-12 && length < 1e200; /* false for NaN and infinity too */
   if (ok) {
      for (r = 0; r < 3; r++) x[r] /= length;
      for (r = 0; r < 3; r++) along += x[r] * y[r];
      for (r = 0; r < 3; r++) y[r] -= along * x[r];
      for (r = 0; r < 3; r++) rest += y[r] * y[r];
      rest = DN_SQRT(rest);
      ok = rest >= 1e-12 && rest < 1e200;
   }
   for (r = 0; r < 9; r++) rotation[r] = r % 4 == 0 ? 1.0f : 0.0f;
   if (!ok) return;
   for (r = 0; r < 3; r++) y[r] /= rest;
   z[0] = x[1] * y[2] - x[2] * y[1];
   z[1] = x[2] * y[0] - x[0] * y[2];
   z[2] = x[0] * y[1] - x[1] * y[0];
   for (r = 0; r < 3; r++) {
      rotation[3 * r] = (float)x[r];
      rotation[3 * r + 1] = (float)y[r];
      rotation[3 * r + 2] = (float)z[r];
   }
}
DN_API void dn_forward_kinematics(const int32_t *parents, const float *offsets, const float *rotations, size_t joints,
                                  float *transforms)
{
   size_t s;
   for (s = 0; s < joints; s++) {
      float local[12];
      int r;
      for (r = 0; r < 3; r++) {
         memcpy(local + 4 * r, rotations + 9 * s + 3 * (size_t)r, 3 * sizeof *local);
         local[4 * r + 3] = offsets[3 * s + (size_t)r];
      }
      DN_ASSERT(parents[s] < 0 || (size_t)parents[s] < s);
      if (parents[s] < 0) memcpy(transforms + 12 * s, local, sizeof local);
      else dn__mul3x4(transforms + 12 * (size_t)parents[s], local, transforms + 12 * s); /* T_s = T_parent [R | o] */
   }
}
DN_API void dn_palette(const float *transforms, const float *inverse_bind, size_t joints, float *palette)
{
   size_t s;
   for (s = 0; s < joints; s++) { /* P_s = T_s inverse(R_s)                                                  T 2.1 */
      float p[12];
      dn__mul3x4(transforms + 12 * s, inverse_bind + 12 * s, p);
      memcpy(palette + 12 * s, p, sizeof p);
   }
}

/* --- the root frame: everything turned back by the root's own rotation */
static void dn__root_rotation(const float *palette, float rotation[9]) /* palette: joint 0's matrix */
{
   float m[9];
   dn__part3x3(palette, m);
   dn_orthonormalise(m, rotation);
}
/* out_s = R^T P_s, all twelve numbers; out may be palette */
static void dn__root_palette(const float *palette, size_t joints, const float rotation[9], float *out)
{
   size_t s;
   for (s = 0; s < joints; s++) {
      float p[12];
      int r, c;
      memcpy(p, palette + 12 * s, sizeof p);
      for (r = 0; r < 3; r++)
         for (c = 0; c < 4; c++)
            out[12 * s + (size_t)(4 * r + c)] = rotation[r] * p[c] + rotation[3 + r] * p[4 + c] + rotation[6 + r] * p[8 + c];
   }
}
static void dn__rotate(const float rotation[9], const float v[3], float out[3]) /* out may be v */
{
   float x = v[0], y = v[1], z = v[2];
   out[0] = rotation[0] * x + rotation[1] * y + rotation[2] * z;
   out[1] = rotation[3] * x + rotation[4] * y + rotation[5] * z;
   out[2] = rotation[6] * x + rotation[7] * y + rotation[8] * z;
}

/* --- LBS: blend the matrices (twelve numbers side by side, which any compiler vectorises), then apply once */
static void dn__lbs_blend(const uint32_t *joint, const float *weight, size_t influences, const float *palette, float m[12])
{
   size_t i;
   int k;
   for (k = 0; k < 12; k++) m[k] = 0.0f;
   for (i = 0; i < influences; i++) {
      const float *p = palette + 12 * (size_t)joint[i];
      float w = weight[i];
      for (k = 0; k < 12; k++) m[k] += w * p[k];
   }
}
/* The same for skinning itself, in double and rounded once at the end: the normals of a finely cut mesh magnify the
   last digits of neighbouring positions some hundred times (10,242 nodes: 4e-5 in float, 1e-5 so). The four
   influences that nearly every character has are spelt out, in the same order: nothing goes through memory. */
static void dn__lbs_blend_double(const uint32_t *joint, const float *weight, size_t influences, const float *palette, double m[12])
{
   size_t i;
   int k;
   if (influences == 4) {
      const float *p = palette + 12 * (size_t)joint[0], *q = palette + 12 * (size_t)joint[1];
      const float *r = palette + 12 * (size_t)joint[2], *s = palette + 12 * (size_t)joint[3];
      double a = (double)weight[0], b = (double)weight[1], c = (double)weight[2], d = (double)weight[3];
      for (k = 0; k < 12; k++) m[k] = a * (double)p[k] + b * (double)q[k] + c * (double)r[k] + d * (double)s[k];
      return;
   }
   for (k = 0; k < 12; k++) m[k] = 0.0;
   for (i = 0; i < influences; i++) {
      const float *p = palette + 12 * (size_t)joint[i];
      double w = (double)weight[i];
      for (k = 0; k < 12; k++) m[k] += w * (double)p[k];
   }
}
static void dn__transform_double(const double m[12], const float p[3], double out[3]) /* m [p; 1] */
{
   double x = (double)p[0], y = (double)p[1], z = (double)p[2];
   out[0] = m[0] * x + m[1] * y + m[2] * z + m[3];
   out[1] = m[4] * x + m[5] * y + m[6] * z + m[7];
   out[2] = m[8] * x + m[9] * y + m[10] * z + m[11];
}
static void dn__lbs_point(const uint32_t *joint, const float *weight, size_t influences, const float *palette,
                          const float rest[3], double out[3])
{
   double m[12];
   dn__lbs_blend_double(joint, weight, influences, palette, m);
   dn__transform_double(m, rest, out);
}
/* points begin..end; row v of joint and weight belongs to point v */
static void dn__lbs_range(const float *rest, const uint32_t *joint, const float *weight, size_t influences,
                          const float *palette, size_t begin, size_t end, float *out)
{
   size_t v;
   for (v = begin; v < end; v++) { /* p = (sum_s w_s P_s) [rest; 1]                                          T 2.1 */
      double p[3];
      int k;
      dn__lbs_point(joint + influences * v, weight + influences * v, influences, palette, rest + 3 * v, p);
      for (k = 0; k < 3; k++) out[3 * v + (size_t)k] = (float)p[k];
   }
}
DN_API void dn_lbs(const float *rest, const uint32_t *joint, const float *weight, size_t influences, size_t count,
                   const float *palette, float *out)
{
   dn__lbs_range(rest, joint, weight, influences, palette, 0, count, out);
}

/* --- DQS. A dual quaternion is 8 floats: real w x y z, dual w x y z; dual = (0, t) real / 2. */
static void dn__dual_quaternion(const float m[12], float q[8])
{
   float part[9], r[9];
   double w, x, y, z, n, t0 = (double)m[3], t1 = (double)m[7], t2 = (double)m[11];
   dn__part3x3(m, part);
   dn_orthonormalise(part, r);
   {
      double a = (double)r[0], b = (double)r[4], c = (double)r[8];
      /* four times the square of each component; the largest is at least 1, so nothing is divided by almost zero */
      double sw = 1.0 + a + b + c, sx = 1.0 + a - b - c, sy = 1.0 - a + b - c, sz = 1.0 - a - b + c;
      double d21 = (double)r[7] - (double)r[5], d02 = (double)r[2] - (double)r[6], d10 = (double)r[3] - (double)r[1];
      double s01 = (double)r[1] + (double)r[3], s02 = (double)r[2] + (double)r[6], s12 = (double)r[5] + (double)r[7];
      if (sw >= sx && sw >= sy && sw >= sz) w = sw, x = d21, y = d02, z = d10;
      else if (sx >= sy && sx >= sz) w = d21, x = sx, y = s01, z = s02;
      else if (sy >= sz) w = d02, x = s01, y = sy, z = s12;
      else w = d10, x = s02, y = s12, z = sz;
   }
   n = 1.0 / DN_SQRT(w * w + x * x + y * y + z * z);
   w *= n, x *= n, y *= n, z *= n;
   q[0] = (float)w;
   q[1] = (float)x;
   q[2] = (float)y;
   q[3] = (float)z;
   q[4] = (float)(-0.5 * (t0 * x + t1 * y + t2 * z));
   q[5] = (float)(0.5 * (t0 * w + t1 * z - t2 * y));
   q[6] = (float)(0.5 * (t1 * w + t2 * x - t0 * z));
   q[7] = (float)(0.5 * (t2 * w + t0 * y - t1 * x));
}
static void dn__dual_quaternions(const float *palette, size_t joints, float *dual) /* dual (S,8) */
{
   size_t s;
   for (s = 0; s < joints; s++) dn__dual_quaternion(palette + 12 * s, dual + 8 * s);
}
/* the joint whose sign the others follow: the heaviest, the lowest joint of several */
static size_t dn__dqs_pivot(const uint32_t *joint, const float *weight, size_t influences)
{
   size_t i, pivot = 0;
   for (i = 1; i < influences; i++)
      if (weight[i] > weight[pivot] || (weight[i] >= weight[pivot] && joint[i] < joint[pivot])) pivot = i;
   return pivot;
}
static void dn__dqs_add(const float pivot[8], const float q[8], float weight, float sum[8])
{
   float dot = pivot[0] * q[0] + pivot[1] * q[1] + pivot[2] * q[2] + pivot[3] * q[3];
   float w = dot < 0.0f ? -weight : weight;
   int k;
   for (k = 0; k < 8; k++) sum[k] += w * q[k];
}
/* b = sum / |real|; R from the real half, t = 2 dual conj(real); without any weight the zero matrix, as LBS gives   T 2.2 */
static void dn__dqs_matrix(const float sum[8], float m[12])
{
   float length = DN_SQRTF(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2] + sum[3] * sum[3]);
   float f = length > 1e-18f ? 1.0f / length : 0.0f, b[8];
   float w, x, y, z, one = length > 1e-18f ? 1.0f : 0.0f;
   int k;
   for (k = 0; k < 8; k++) b[k] = sum[k] * f;
   w = b[0];
   x = b[1];
   y = b[2];
   z = b[3];
   m[0] = one - 2.0f * (y * y + z * z);
   m[1] = 2.0f * (x * y - w * z);
   m[2] = 2.0f * (x * z + w * y);
   m[3] = 2.0f * (w * b[5] - b[4] * x + y * b[7] - z * b[6]);
   m[4] = 2.0f * (x * y + w * z);
   m[5] = one - 2.0f * (x * x + z * z);
   m[6] = 2.0f * (y * z - w * x);
   m[7] = 2.0f * (w * b[6] - b[4] * y + z * b[5] - x * b[7]);
   m[8] = 2.0f * (x * z - w * y);
   m[9] = 2.0f * (y * z + w * x);
   m[10] = one - 2.0f * (x * x + y * y);
   m[11] = 2.0f * (w * b[7] - b[4] * z + x * b[6] - y * b[5]);
}
/* the rigid motion of one point; dual (S,8) from dn__dual_quaternions */
static void dn__dqs_blend(const uint32_t *joint, const float *weight, size_t influences, const float *dual, float m[12])
{
   const float *pivot = dual + 8 * (size_t)joint[dn__dqs_pivot(joint, weight, influences)];
   float sum[8] = { 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f };
   size_t i;
   for (i = 0; i < influences; i++) dn__dqs_add(pivot, dual + 8 * (size_t)joint[i], weight[i], sum);
   dn__dqs_matrix(sum, m);
}
static void dn__dqs_range(const float *rest, const uint32_t *joint, const float *weight, size_t influences, const float *dual,
                          size_t begin, size_t end, float *out)
{
   size_t v;
   for (v = begin; v < end; v++) {
      float m[12];
      dn__dqs_blend(joint + influences * v, weight + influences * v, influences, dual, m);
      dn__transform(m, rest + 3 * v, out + 3 * v);
   }
}
/* without scratch: the joints' dual quaternions are made anew for every point */
DN_API void dn_dqs(const float *rest, const uint32_t *joint, const float *weight, size_t influences, size_t count,
                   const float *palette, float *out)
{
   size_t v, i;
   if (influences == 0) {
      memset(out, 0, 3 * count * sizeof *out);
      return;
   }
   for (v = 0; v < count; v++) {
      const uint32_t *j = joint + influences * v;
      const float *w = weight + influences * v;
      float pivot[8], q[8], sum[8] = { 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f }, m[12];
      dn__dual_quaternion(palette + 12 * (size_t)j[dn__dqs_pivot(j, w, influences)], pivot);
      for (i = 0; i < influences; i++)
         if (w[i] > 0.0f || w[i] < 0.0f) {
            dn__dual_quaternion(palette + 12 * (size_t)j[i], q);
            dn__dqs_add(pivot, q, w[i], sum);
         }
      dn__dqs_matrix(sum, m);
      dn__transform(m, rest + 3 * v, out + 3 * v);
   }
}

/* --- back to rest space: d_rest solves M d_rest = d, M the 3x3 part of the point's blended matrix. A point whose
   matrix is flat has no such d; it gets zero. Returns whether it was solved. */
static int dn__unskin(const float m[12], const float d[3], float out[3])
{
   double a[9], scale = 0.0, det, c0, c1, c2, x = (double)d[0], y = (double)d[1], z = (double)d[2];
   int r, c;
   for (r = 0; r < 3; r++)
      for (c = 0; c < 3; c++) {
         double v = (double)m[4 * r + c];
         a[3 * r + c] = v;
         scale = DN_FABS(v) > scale ? DN_FABS(v) : scale;
      }
   c0 = a[4] * a[8] - a[5] * a[7];
   c1 = a[5] * a[6] - a[3] * a[8];
   c2 = a[3] * a[7] - a[4] * a[6];
   det = a[0] * c0 + a[1] * c1 + a[2] * c2;
   out[0] = out[1] = out[2] = 0.0f;
   if (!(DN_FABS(det) > 1e-6 * scale * scale * scale) || !(DN_FABS(det) < 1e300)) return 0;
   out[0] = (float)((c0 * x + (a[2] * a[7] - a[1] * a[8]) * y + (a[1] * a[5] - a[2] * a[4]) * z) / det);
   out[1] = (float)((c1 * x + (a[0] * a[8] - a[2] * a[6]) * y + (a[2] * a[3] - a[0] * a[5]) * z) / det);
   out[2] = (float)((c2 * x + (a[1] * a[6] - a[0] * a[7]) * y + (a[0] * a[4] - a[1] * a[3]) * z) / det);
   for (r = 0; r < 3; r++)
      if (!dn__finite(out[r])) return out[0] = out[1] = out[2] = 0.0f, 0;
   return 1;
}

/* --- rows (N,D): each writer fills its own columns of rows begin..end; `rows` points at the first of those columns of
   row 0, stride is D in floats */
static void dn__rows_copy(const float *from, size_t width, size_t begin, size_t end, float *rows, size_t stride)
{
   size_t i;
   for (i = begin; i < end; i++) memcpy(rows + i * stride, from + i * width, width * sizeof *rows);
}
static void dn__rows_position(const float *coarse, size_t begin, size_t end, float *rows, size_t stride)
{
   dn__rows_copy(coarse, 3, begin, end, rows, stride);
}
static void dn__rows_normal(const float *normals, size_t begin, size_t end, float *rows, size_t stride)
{
   dn__rows_copy(normals, 3, begin, end, rows, stride);
}
static void dn__rows_geodesic(const float *geodesic, size_t joints, size_t begin, size_t end, float *rows, size_t stride)
{
   dn__rows_copy(geodesic, joints, begin, end, rows, stride);
}
/* r_i = sum_s w_s Rot(P_s) rest_i, the 3x3 part as it is (T 3.9). rest (N,3); node i's joints and weights are row
   vertex[i] of (V,I), or row i when vertex is NULL */
static void dn__rows_relative(const float *rest, const uint32_t *joint, const float *weight, size_t influences,
                              const uint32_t *vertex, const float *palette, size_t begin, size_t end, float *rows,
                              size_t stride)
{
   size_t i;
   for (i = begin; i < end; i++) {
      size_t v = vertex ? vertex[i] : i;
      double m[12], x[3];
      int k;
      dn__lbs_blend_double(joint + influences * v, weight + influences * v, influences, palette, m);
      m[3] = m[7] = m[11] = 0.0; /* the 3x3 part alone */
      dn__transform_double(m, rest + 3 * i, x);
      for (k = 0; k < 3; k++) rows[i * stride + (size_t)k] = (float)x[k];
   }
}
/* where the joints are now: P_s [joint at rest; 1]; joint s of the model is map[s] in the palette, or s when map is NULL */
static void dn__posed_joints(const float *palette, const uint32_t *map, const float *joint_rest, size_t joints, float *posed)
{
   size_t s;
   for (s = 0; s < joints; s++) dn__transform(palette + 12 * (size_t)(map ? map[s] : s), joint_rest + 3 * s, posed + 3 * s);
}
/* |p_i - posed_s| for every joint (C 4.4) */
static void dn__rows_distance(const float *coarse, const float *posed, size_t joints, size_t begin, size_t end, float *rows,
                              size_t stride)
{
   size_t i, s;
   for (i = begin; i < end; i++) {
      float px = coarse[3 * i], py = coarse[3 * i + 1], pz = coarse[3 * i + 2], *row = rows + i * stride;
      for (s = 0; s < joints; s++) {
         float x = px - posed[3 * s], y = py - posed[3 * s + 1], z = pz - posed[3 * s + 2];
         row[s] = DN_SQRTF(x * x + y * y + z * z);
      }
   }
}

/* ===================================================================================== >>geodesic
   in       rest nodes (N,3), triangles (T,3), joints (S,3)     out   distance through the body (N,S), skin weights
   touches  the scratch passed in, nothing else: no allocation, no I/O, no statics
   paper    T 3.2.1; spec section 3 decides. Dionne & de Lasa, Geodesic Voxel Binding, SCA 2013. Paths: after Nash,
            Koenig, Tovey, Lazy Theta*, AAAI 2010: a cell's parent is not its neighbour but the last bend of its path,
            seen in a straight line, so lengths are Euclidean and not staircases
   grid     cells of edge (longest side / R); coordinates here are in cells, the bounding box starts at 1.5:
            flat sides that lie on the box meet a cell's middle and not a wall between two, and one layer is free
            all round for the flood
   read     dn__voxelise, dn__sees, dn__solve, dn__distance_at */

#define DN__SOURCE 0x80000000u /* parent codes: cell id, or DN__SOURCE + k for segment k of the source */
#define DN__FAR 3.0e38f
#define DN__BLOCK 8u           /* ids are given block by block of 8^3 cells: near cells are near in memory too */
#define DN__BUCKETS 16u        /* of a quarter cell each; a step is at most sqrt(3) cells */

typedef struct dn__voxels {
   size_t n[3], cells, inner;      /* inner: cells without the free layer, the most that can be solid */
   size_t b[3], blocks;
   double origin[3], cell;
   size_t count;                   /* M solid cells */
   size_t blocks_used;
   unsigned char *solid;           /* (cells) 1 or 0 */
   uint32_t *id_of;                /* (cells) of solid cells */
   uint32_t *place;                /* (M) x | y << 10 | z << 20 */
   uint32_t *block_first;          /* (blocks_used+1) ids; blocks without solid cells are left out */
   uint32_t *block_place;          /* (blocks_used) packed like place, in blocks */
   uint32_t *node_id;              /* (N) the cell each node lies in */
} dn__voxels;

typedef struct dn__front { /* one joint's search; one per worker */
   float *g;               /* (M) path length in cells, without the gap to the joint */
   uint32_t *parent;       /* (M) */
   uint32_t *next, *prev;  /* (M) the queue's lists */
   unsigned char *state;   /* (M) */
   float *block_least;     /* (blocks_used) least g in each block */
   uint32_t head[DN__BUCKETS];
   size_t current, queued; /* bucket now served; cells in all buckets */
} dn__front;
enum { DN__UNSEEN, DN__GUESSED /* queued, line to the parent not looked at yet */, DN__KNOWN /* queued */, DN__CLOSED };

typedef struct dn__source { /* where distances start: segments in grid coordinates, a point is one of no length */
   const float *segment;    /* (count,6) */
   size_t count;
   float gap;               /* cells from there to the joint, when that is outside the solid */
} dn__source;

/* --- grid and memory */
static void dn__voxel_grid(const float *positions, size_t nodes, unsigned resolution, dn__voxels *v)
{
   double lo[3] = { 0.0, 0.0, 0.0 }, hi[3] = { 0.0, 0.0, 0.0 }, longest = 0.0;
   size_t i, inner = 1, k;
   if (resolution == 0) resolution = 128;
   if (resolution > 512) resolution = 512;
   for (i = 0; i < nodes; i++)
      for (k = 0; k < 3; k++) {
         double p = (double)positions[3 * i + k];
         if (i == 0 || p < lo[k]) lo[k] = p;
         if (i == 0 || p > hi[k]) hi[k] = p;
      }
   for (k = 0; k < 3; k++)
      if (hi[k] - lo[k] > longest) longest = hi[k] - lo[k];
   v->cell = longest > 0.0 ? longest / (double)resolution : 1.0;
   v->cells = v->blocks = 1;
   for (k = 0; k < 3; k++) {
      double side = (hi[k] - lo[k]) / v->cell + 1.5; /* never above R + 1.5, but NaN must not reach the cast */
      size_t n = side >= 1.0 && side < 1000.0 ? (size_t)side : 1;
      v->origin[k] = lo[k] - 1.5 * v->cell;
      v->n[k] = n + 2;
      v->b[k] = (n + 2 + DN__BLOCK - 1) / DN__BLOCK;
      v->cells = dn__mul(v->cells, v->n[k]);
      v->blocks *= v->b[k];
      inner = dn__mul(inner, n);
   }
   v->inner = inner;
   v->count = v->blocks_used = 0;
}
static void dn__voxel_layout(dn__arena *a, dn__voxels *v, size_t nodes)
{
   v->solid = (unsigned char *)dn__take(a, v->cells, 1);
   v->id_of = (uint32_t *)dn__take(a, v->cells, sizeof(uint32_t));
   v->place = (uint32_t *)dn__take(a, v->inner, sizeof(uint32_t));
   v->block_first = (uint32_t *)dn__take(a, v->blocks + 1, sizeof(uint32_t));
   v->block_place = (uint32_t *)dn__take(a, v->blocks, sizeof(uint32_t));
   v->node_id = (uint32_t *)dn__take(a, nodes, sizeof(uint32_t));
}
static dn__front dn__front_layout(dn__arena *a, size_t count, size_t blocks)
{
   dn__front f;
   memset(&f, 0, sizeof f);
   f.g = (float *)dn__take(a, count, sizeof(float));
   f.parent = (uint32_t *)dn__take(a, count, sizeof(uint32_t));
   f.next = (uint32_t *)dn__take(a, count, sizeof(uint32_t));
   f.prev = (uint32_t *)dn__take(a, count, sizeof(uint32_t));
   f.state = (unsigned char *)dn__take(a, count, 1);
   f.block_least = (float *)dn__take(a, blocks, sizeof(float));
   return f;
}
static void dn__to_grid(const dn__voxels *v, const float *p, float out[3])
{
   int k;
   for (k = 0; k < 3; k++) out[k] = (float)(((double)p[k] - v->origin[k]) / v->cell);
}
static int dn__in_grid(const dn__voxels *v, const float p[3])
{
   return p[0] >= 0.0f && p[1] >= 0.0f && p[2] >= 0.0f && p[0] < (float)v->n[0] && p[1] < (float)v->n[1] &&
          p[2] < (float)v->n[2];
}
static size_t dn__cell_at(const dn__voxels *v, const float p[3]) /* p in the grid */
{
   return (size_t)p[0] + v->n[0] * ((size_t)p[1] + v->n[1] * (size_t)p[2]);
}
static void dn__centre(uint32_t place, float out[3])
{
   out[0] = (float)(place & 1023u) + 0.5f;
   out[1] = (float)(place >> 10 & 1023u) + 0.5f;
   out[2] = (float)(place >> 20) + 0.5f;
}
static float dn__apart(const float a[3], const float b[3])
{
   float x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
   return DN_SQRTF(x * x + y * y + z * z);
}
static size_t dn__clamp_cell(double x, size_t n) /* into 1 .. n-2: never the free layer */
{
   return x >= 1.0 ? (x < (double)(n - 2) ? (size_t)x : n - 2) : 1; /* NaN: 1 */
}

/* --- solid cells. A cell is on the surface when the closed box meets the triangle: separating axes, of which the
   boxes' own are the loops' bounds, the plane is the column's depth range, and the nine others are precomputed. The
   walk over columns costs the triangle's area and not its bounding box's volume. */
#define DN__TOUCH 1e-5 /* cells: a triangle in the wall between two cells marks both */
static void dn__mark_triangle(dn__voxels *v, const float *positions, const uint32_t *t)
{
   double p[3][3], normal[3], axis[9][2], low[9], high[9], longest = 0.0, size = 0.0;
   size_t from[3], to[3], c[3], stride[3], k, j, w, ua, va;
   stride[0] = 1;
   stride[1] = v->n[0];
   stride[2] = v->n[0] * v->n[1];
   for (k = 0; k < 3; k++)
      for (j = 0; j < 3; j++) p[k][j] = ((double)positions[3 * (size_t)t[k] + j] - v->origin[j]) / v->cell;
   for (j = 0; j < 3; j++) {
      double lo = p[0][j], hi = p[0][j];
      for (k = 1; k < 3; k++) {
         if (p[k][j] < lo) lo = p[k][j];
         if (p[k][j] > hi) hi = p[k][j];
      }
      from[j] = dn__clamp_cell(lo - DN__TOUCH, v->n[j]);
      to[j] = dn__clamp_cell(hi + DN__TOUCH, v->n[j]);
      if (hi - lo > longest) longest = hi - lo;
   }
   for (j = 0; j < 3; j++) {
      size_t a = (j + 1) % 3, b = (j + 2) % 3;
      normal[j] = (p[1][a] - p[0][a]) * (p[2][b] - p[0][b]) - (p[1][b] - p[0][b]) * (p[2][a] - p[0][a]);
      size += DN_FABS(normal[j]);
   }
   if (!(size > 1e-9 * longest * longest)) { /* a line: its direction has no plane; step along each edge */
      for (k = 0; k < 3; k++) {
         const double *a = p[k], *b = p[(k + 1) % 3];
         size_t s, steps = 4 * (size_t)(longest < 1000.0 ? longest : 1000.0) + 4;
         for (s = 0; s <= steps; s++) {
            double f = (double)s / (double)steps;
            for (j = 0; j < 3; j++) c[j] = dn__clamp_cell(a[j] + f * (b[j] - a[j]), v->n[j]);
            v->solid[c[0] + stride[1] * c[1] + stride[2] * c[2]] = 1;
         }
      }
      return;
   }
   for (k = 0; k < 3; k++)      /* edge k .. k+1, seen along axis j: a line in 2D and the vertex across from it */
      for (j = 0; j < 3; j++) {
         size_t a = (j + 1) % 3, b = (j + 2) % 3, e = 3 * k + j;
         const double *p0 = p[k], *p1 = p[(k + 1) % 3], *p2 = p[(k + 2) % 3];
         double x = p0[b] - p1[b], y = p1[a] - p0[a];
         double f = x * p0[a] + y * p0[b], g = x * p2[a] + y * p2[b], r = (0.5 + DN__TOUCH) * (DN_FABS(x) + DN_FABS(y));
         axis[e][0] = x;
         axis[e][1] = y;
         low[e] = (f < g ? f : g) - r;
         high[e] = (f < g ? g : f) + r;
      }
   w = DN_FABS(normal[0]) >= DN_FABS(normal[1]) ? 0 : 1; /* the axis the triangle faces most */
   if (DN_FABS(normal[2]) > DN_FABS(normal[w])) w = 2;
   ua = (w + 1) % 3;
   va = (w + 2) % 3;
   for (c[va] = from[va]; c[va] <= to[va]; c[va]++)
      for (c[ua] = from[ua]; c[ua] <= to[ua]; c[ua]++) {
         double du = (double)c[ua] + 0.5 - p[0][ua], dv = (double)c[va] + 0.5 - p[0][va];
         double mid = p[0][w] - (normal[ua] * du + normal[va] * dv) / normal[w];
         double half = (0.5 + DN__TOUCH) * (DN_FABS(normal[ua]) + DN_FABS(normal[va])) / DN_FABS(normal[w]) + DN__TOUCH;
         size_t first = dn__max(from[w], dn__clamp_cell(mid - half, v->n[w]));
         size_t last = dn__min(to[w], dn__clamp_cell(mid + half, v->n[w]));
         for (c[w] = first; c[w] <= last; c[w]++) {
            double centre[3];
            int meets = 1;
            for (j = 0; j < 3; j++) centre[j] = (double)c[j] + 0.5;
            for (k = 0; k < 9; k++) {
               double x = axis[k][0] * centre[(k + 1) % 3] + axis[k][1] * centre[(k + 2) % 3]; /* k % 3 is the axis j */
               meets &= (x >= low[k]) & (x <= high[k]);
            }
            if (meets) v->solid[c[0] + stride[1] * c[1] + stride[2] * c[2]] = 1;
         }
      }
}
/* Everything the outside cannot reach by faces is solid; then ids. Cells with a node are solid even without a triangle. */
static void dn__voxelise(dn__voxels *v, const float *positions, size_t nodes, const uint32_t *triangle, size_t triangles)
{
   size_t stride[3], i, k, head = 0, tail = 0, c[3], block[3];
   uint32_t *queue = v->id_of; /* not yet in use */
   stride[0] = 1;
   stride[1] = v->n[0];
   stride[2] = v->n[0] * v->n[1];
   memset(v->solid, 0, v->cells);
   for (i = 0; i < triangles; i++) dn__mark_triangle(v, positions, triangle + 3 * i);
   for (i = 0; i < nodes; i++) {
      float p[3];
      size_t at = 0;
      dn__to_grid(v, positions + 3 * i, p);
      for (k = 0; k < 3; k++) at += stride[k] * dn__clamp_cell((double)p[k], v->n[k]);
      v->solid[at] = 1;
   }
   v->solid[0] = 2; /* a corner of the free layer */
   queue[tail++] = 0;
   while (head < tail) {
      size_t at = queue[head++];
      c[0] = at % stride[1];
      c[1] = at / stride[1] % v->n[1];
      c[2] = at / stride[2];
      for (k = 0; k < 3; k++) {
         if (c[k] > 0 && v->solid[at - stride[k]] == 0) v->solid[at - stride[k]] = 2, queue[tail++] = (uint32_t)(at - stride[k]);
         if (c[k] + 1 < v->n[k] && v->solid[at + stride[k]] == 0)
            v->solid[at + stride[k]] = 2, queue[tail++] = (uint32_t)(at + stride[k]);
      }
   }
   for (i = 0; i < v->cells; i++) v->solid[i] = v->solid[i] != 2;

   v->count = v->blocks_used = 0;
   for (block[2] = 0; block[2] < v->b[2]; block[2]++)
      for (block[1] = 0; block[1] < v->b[1]; block[1]++)
         for (block[0] = 0; block[0] < v->b[0]; block[0]++) {
            size_t end[3], start = v->count;
            for (k = 0; k < 3; k++) end[k] = dn__min((block[k] + 1) * DN__BLOCK, v->n[k]);
            for (c[2] = block[2] * DN__BLOCK; c[2] < end[2]; c[2]++)
               for (c[1] = block[1] * DN__BLOCK; c[1] < end[1]; c[1]++)
                  for (c[0] = block[0] * DN__BLOCK; c[0] < end[0]; c[0]++) {
                     size_t at = c[0] + stride[1] * c[1] + stride[2] * c[2];
                     if (!v->solid[at]) continue;
                     v->id_of[at] = (uint32_t)v->count;
                     v->place[v->count++] = (uint32_t)(c[0] | c[1] << 10 | c[2] << 20);
                  }
            if (v->count == start) continue;
            v->block_first[v->blocks_used] = (uint32_t)start;
            v->block_place[v->blocks_used++] = (uint32_t)(block[0] | block[1] << 10 | block[2] << 20);
         }
   v->block_first[v->blocks_used] = (uint32_t)v->count;
   for (i = 0; i < nodes; i++) {
      float p[3];
      size_t at = 0;
      dn__to_grid(v, positions + 3 * i, p);
      for (k = 0; k < 3; k++) at += stride[k] * dn__clamp_cell((double)p[k], v->n[k]);
      v->node_id[i] = v->id_of[at];
   }
}

/* --- line of sight: does the segment a b, both ends in the grid, stay in solid cells? A step over an edge or a corner
   goes straight across: the two cells share it. */
static int dn__sees(const dn__voxels *v, const float a[3], const float b[3])
{
   const unsigned char *at = v->solid;
   float tx = DN__FAR, ty = DN__FAR, tz = DN__FAR, dx = 0.0f, dy = 0.0f, dz = 0.0f, slack;
   ptrdiff_t sx = 1, sy = (ptrdiff_t)v->n[0], sz = (ptrdiff_t)(v->n[0] * v->n[1]);
   int x = (int)a[0], y = (int)a[1], z = (int)a[2];
   int lx = (int)b[0] - x, ly = (int)b[1] - y, lz = (int)b[2] - z;
   at += (ptrdiff_t)x + sy * (ptrdiff_t)y + sz * (ptrdiff_t)z;
   if (!*at) return 0;
   /* t: fraction of the segment at which the next wall is crossed; l: walls still to cross */
   if (lx) {
      dx = 1.0f / DN_FABSF(b[0] - a[0]);
      tx = (lx > 0 ? (float)(x + 1) - a[0] : a[0] - (float)x) * dx;
      if (lx < 0) sx = -sx, lx = -lx;
   }
   if (ly) {
      dy = 1.0f / DN_FABSF(b[1] - a[1]);
      ty = (ly > 0 ? (float)(y + 1) - a[1] : a[1] - (float)y) * dy;
      if (ly < 0) sy = -sy, ly = -ly;
   }
   if (lz) {
      dz = 1.0f / DN_FABSF(b[2] - a[2]);
      tz = (lz > 0 ? (float)(z + 1) - a[2] : a[2] - (float)z) * dz;
      if (lz < 0) sz = -sz, lz = -lz;
   }
   slack = 1e-3f / (float)(lx + ly + lz + 1); /* walls crossed within about a thousandth of a cell count as at once */
   while (lx + ly + lz > 0) {
      float t = (tx < ty ? tx : ty);
      t = (tz < t ? tz : t) + slack;
      if (tx <= t) at += sx, tx = --lx > 0 ? tx + dx : DN__FAR;
      if (ty <= t) at += sy, ty = --ly > 0 ? ty + dy : DN__FAR;
      if (tz <= t) at += sz, tz = --lz > 0 ? tz + dz : DN__FAR;
      if (!*at) return 0;
   }
   return 1;
}

/* --- the search. Parents are bends; a guess (the parent's parent line) is queued unchecked and looked at when its turn
   comes, which is once for nearly every cell. Closed cells only ever get shorter, by steps that count: it ends. */
static void dn__queue_add(dn__front *f, uint32_t id)
{
   float key = f->g[id] * 4.0f;
   size_t k = key < 1e9f ? (size_t)key : f->current + DN__BUCKETS; /* served early at worst, see above */
   k = dn__max(f->current, dn__min(k, f->current + DN__BUCKETS - 1)) % DN__BUCKETS;
   f->prev[id] = DN__SOURCE + (uint32_t)k; /* a list's first: names its bucket */
   f->next[id] = f->head[k];
   if (f->head[k] != DN__NONE) f->prev[f->head[k]] = id;
   f->head[k] = id;
   f->queued++;
}
static void dn__queue_drop(dn__front *f, uint32_t id)
{
   uint32_t prev = f->prev[id], next = f->next[id];
   if (prev >= DN__SOURCE) f->head[prev - DN__SOURCE] = next;
   else f->next[prev] = next;
   if (next != DN__NONE) f->prev[next] = prev;
   f->queued--;
}
/* where a path bends towards `to` when its parent is `code`, and the length up to there */
static float dn__anchor(const dn__voxels *v, const dn__front *f, const dn__source *s, uint32_t code, const float to[3],
                        float out[3])
{
   const float *a;
   float d[3], along = 0.0f, square = 0.0f;
   int k;
   if (code < DN__SOURCE) {
      dn__centre(v->place[code], out);
      return f->g[code];
   }
   a = s->segment + 6 * (size_t)(code - DN__SOURCE); /* closest point of the segment */
   for (k = 0; k < 3; k++) {
      d[k] = a[k + 3] - a[k];
      square += d[k] * d[k];
      along += d[k] * (to[k] - a[k]);
   }
   along = square > 0.0f ? along / square : 0.0f;
   along = along > 0.0f ? (along < 1.0f ? along : 1.0f) : 0.0f;
   for (k = 0; k < 3; k++) out[k] = a[k] + along * d[k];
   return 0.0f;
}
/* length of the path to `to` that bends last at `code`, DN__FAR when it is not below `limit` or not in sight */
static float dn__via(const dn__voxels *v, const dn__front *f, const dn__source *s, uint32_t code, const float to[3],
                     float limit)
{
   float bend[3], length = dn__anchor(v, f, s, code, to, bend);
   length += dn__apart(bend, to);
   if (!(length < limit)) return DN__FAR;
   if (code >= DN__SOURCE && !dn__in_grid(v, bend)) return DN__FAR;
   return dn__sees(v, bend, to) ? length : DN__FAR;
}
/* the best path to the cell from its closed neighbours: round their last bend when that is in sight, or round them */
static void dn__settle(const dn__voxels *v, dn__front *f, const dn__source *s, uint32_t id, uint32_t blind)
{
   static const float step[4] = { 0.0f, 1.0f, 1.41421356f, 1.73205081f };
   uint32_t place = v->place[id], best = blind;
   size_t x = place & 1023u, y = place >> 10 & 1023u, z = place >> 20;
   float to[3], length = DN__FAR;
   int pass, dx, dy, dz;
   dn__centre(place, to);
   for (pass = 0; pass < 2; pass++)
      for (dz = -1; dz <= 1; dz++)
         for (dy = -1; dy <= 1; dy++)
            for (dx = -1; dx <= 1; dx++) { /* the free layer keeps all 26 in the grid */
               size_t at = (size_t)((ptrdiff_t)x + dx) +
                           v->n[0] * ((size_t)((ptrdiff_t)y + dy) + v->n[1] * (size_t)((ptrdiff_t)z + dz));
               uint32_t m;
               float l;
               if (!v->solid[at]) continue;
               m = v->id_of[at];
               if (f->state[m] != DN__CLOSED || m == id) continue;
               if (pass == 0) {
                  l = f->g[m] + step[(dx != 0) + (dy != 0) + (dz != 0)];
                  if (l < length) length = l, best = m;
               } else if (f->parent[m] != blind && f->parent[m] != best) {
                  l = dn__via(v, f, s, f->parent[m], to, length);
                  if (l < length) length = l, best = f->parent[m];
               }
            }
   f->g[id] = length;
   f->parent[id] = best;
}
static void dn__solve(const dn__voxels *v, dn__front *f, const dn__source *s, const uint32_t *seed, size_t seeds)
{
   size_t i, k;
   ptrdiff_t stride[6];
   stride[0] = -1;
   stride[1] = 1;
   stride[2] = -(ptrdiff_t)v->n[0];
   stride[3] = (ptrdiff_t)v->n[0];
   stride[4] = -(ptrdiff_t)(v->n[0] * v->n[1]);
   stride[5] = (ptrdiff_t)(v->n[0] * v->n[1]);
   for (i = 0; i < v->count; i++) f->g[i] = DN__FAR;
   memset(f->state, DN__UNSEEN, v->count);
   for (k = 0; k < DN__BUCKETS; k++) f->head[k] = DN__NONE;
   f->current = f->queued = 0;
   for (i = 0; i < seeds; i++) { /* (cell, segment) pairs */
      uint32_t id = seed[2 * i], code = DN__SOURCE + seed[2 * i + 1];
      float to[3], bend[3], length;
      dn__centre(v->place[id], to);
      length = dn__anchor(v, f, s, code, to, bend) + dn__apart(bend, to);
      if (!(length < f->g[id])) continue;
      if (f->state[id] == DN__KNOWN) dn__queue_drop(f, id);
      f->g[id] = length;
      f->parent[id] = code;
      f->state[id] = DN__KNOWN;
      dn__queue_add(f, id);
   }
   while (f->queued > 0) {
      uint32_t id = f->head[f->current % DN__BUCKETS], code;
      float centre[3], bend[3], up_to;
      size_t at;
      if (id == DN__NONE) {
         f->current++;
         continue;
      }
      dn__queue_drop(f, id);
      dn__centre(v->place[id], centre);
      at = dn__cell_at(v, centre);
      if (f->state[id] == DN__GUESSED) {
         code = f->parent[id];
         (void)dn__anchor(v, f, s, code, centre, bend);
         if (!dn__in_grid(v, bend) || !dn__sees(v, bend, centre)) { /* a bend between: queue again by what it takes */
            dn__settle(v, f, s, id, code);
            f->state[id] = DN__KNOWN;
            dn__queue_add(f, id);
            continue;
         }
      }
      f->state[id] = DN__CLOSED;
      code = f->parent[id];
      for (k = 0; k < 6; k++) {
         const unsigned char *near_solid = v->solid + (ptrdiff_t)at + stride[k];
         uint32_t m;
         float to[3], length;
         if (!*near_solid) continue;
         m = v->id_of[near_solid - v->solid];
         to[0] = centre[0];
         to[1] = centre[1];
         to[2] = centre[2];
         to[k >> 1] += k & 1 ? 1.0f : -1.0f;
         up_to = dn__anchor(v, f, s, code, to, bend);
         length = up_to + dn__apart(bend, to);
         if (!(length < f->g[m] - 1e-3f)) continue;
         if (f->state[m] == DN__CLOSED) { /* known paths give way to looked-at ones only */
            if (!dn__in_grid(v, bend) || !dn__sees(v, bend, to)) continue;
            f->state[m] = DN__KNOWN;
         } else {
            if (f->state[m] != DN__UNSEEN) dn__queue_drop(f, m);
            f->state[m] = DN__GUESSED;
         }
         f->g[m] = length;
         f->parent[m] = code;
         dn__queue_add(f, m);
      }
   }
}

/* --- distances at points. Straight from the source where it is in sight, so exact in a convex solid; else round the
   last bend of a cell nearby, measured to the point itself. */
static float dn__distance_at(const dn__voxels *v, const dn__front *f, const dn__source *s, uint32_t home, const float p[3])
{
   uint32_t place = v->place[home], tried = DN__NONE;
   size_t x = place & 1023u, y = place >> 10 & 1023u, z = place >> 20, k;
   float centre[3], best = DN__FAR;
   int dx, dy, dz;
   for (k = 0; k < s->count; k++) {
      float l = dn__via(v, f, s, DN__SOURCE + (uint32_t)k, p, best);
      if (l < best) best = l;
   }
   if (best < DN__FAR) return best;
   dn__centre(place, centre);
   best = f->g[home] + dn__apart(centre, p);
   if (f->parent[home] < DN__SOURCE) {
      float l = dn__via(v, f, s, f->parent[home], p, best);
      tried = f->parent[home];
      if (l < best) best = l;
   }
   for (dz = -1; dz <= 1; dz++)
      for (dy = -1; dy <= 1; dy++)
         for (dx = -1; dx <= 1; dx++) {
            size_t at = (size_t)((ptrdiff_t)x + dx) +
                        v->n[0] * ((size_t)((ptrdiff_t)y + dy) + v->n[1] * (size_t)((ptrdiff_t)z + dz));
            uint32_t m, code;
            float l;
            if (!v->solid[at]) continue;
            m = v->id_of[at];
            if (f->state[m] != DN__CLOSED) continue;
            code = f->parent[m];
            if (code >= DN__SOURCE || code == tried) continue;
            l = dn__via(v, f, s, code, p, best);
            if (l < best) best = l;
         }
   return best;
}
static void dn__block_minima(const dn__voxels *v, dn__front *f)
{
   size_t b, i;
   for (b = 0; b < v->blocks_used; b++) {
      float least = DN__FAR;
      for (i = v->block_first[b]; i < v->block_first[b + 1]; i++)
         if (f->g[i] < least) least = f->g[i];
      f->block_least[b] = least;
   }
}
/* p lies in a part that the source cannot reach: min over reached cells m of g(m) + |p - m|. Whole blocks are passed
   over by the least that they could give; *hint is the last point's answer, mostly a good start. */
static float dn__distance_across(const dn__voxels *v, const dn__front *f, const float p[3], uint32_t *hint)
{
   float best = DN__FAR, centre[3];
   size_t b, i, k;
   if (*hint != DN__NONE) {
      dn__centre(v->place[*hint], centre);
      best = f->g[*hint] + dn__apart(centre, p);
   }
   for (b = 0; b < v->blocks_used; b++) {
      uint32_t place = v->block_place[b], low[3];
      float square = 0.0f, room = best - f->block_least[b];
      if (!(room > 0.0f)) continue;
      low[0] = place & 1023u;
      low[1] = place >> 10 & 1023u;
      low[2] = place >> 20;
      for (k = 0; k < 3; k++) { /* from p to the block's box */
         float lo = (float)(low[k] * DN__BLOCK), hi = lo + (float)DN__BLOCK;
         float d = p[k] < lo ? lo - p[k] : (p[k] > hi ? p[k] - hi : 0.0f);
         square += d * d;
      }
      if (best < DN__FAR && square >= room * room) continue;
      for (i = v->block_first[b]; i < v->block_first[b + 1]; i++) {
         float l;
         if (!(f->g[i] < best)) continue;
         dn__centre(v->place[i], centre);
         l = f->g[i] + dn__apart(centre, p);
         if (l < best) best = l, *hint = (uint32_t)i;
      }
   }
   return best;
}

/* --- where a search starts: the solid cells that the segments pass through. When there are none, the surface point
   nearest to them, with the gap to it: of a joint outside that point and its cell are the nearest, and where many cells
   are about equally near (a joint in the middle of a ring) the choice does not hang on how the grid happens to lie. */
static float dn__closest_on_segment(const float *seg, const float p[3], float out[3])
{
   dn__source one;
   one.segment = seg;
   one.count = 1;
   one.gap = 0.0f;
   (void)dn__anchor(NULL, NULL, &one, DN__SOURCE, p, out);
   return dn__apart(out, p);
}
/* closest point of the triangle t (3,3) to p: the foot of the perpendicular when it falls inside, else on an edge */
static float dn__closest_on_triangle(const float *t, const float p[3], float out[3])
{
   double u[3], w[3], d[3], uu = 0.0, uw = 0.0, ww = 0.0, ud = 0.0, wd = 0.0, det, a, b;
   float best = DN__FAR;
   int k, j;
   for (k = 0; k < 3; k++) {
      u[k] = (double)t[3 + k] - (double)t[k];
      w[k] = (double)t[6 + k] - (double)t[k];
      d[k] = (double)p[k] - (double)t[k];
      uu += u[k] * u[k];
      uw += u[k] * w[k];
      ww += w[k] * w[k];
      ud += u[k] * d[k];
      wd += w[k] * d[k];
   }
   det = uu * ww - uw * uw;
   a = ww * ud - uw * wd; /* the foot is corner 0 + (a u + b w) / det */
   b = uu * wd - uw * ud;
   if (det > 1e-12 * uu * ww && a >= 0.0 && b >= 0.0 && a + b <= det) {
      for (k = 0; k < 3; k++) out[k] = (float)((double)t[k] + (a * u[k] + b * w[k]) / det);
      return dn__apart(out, p);
   }
   for (k = 0; k < 3; k++) {
      float edge[6], q[3], l;
      for (j = 0; j < 3; j++) {
         edge[j] = t[3 * k + j];
         edge[3 + j] = t[3 * (k == 2 ? 0 : k + 1) + j];
      }
      l = dn__closest_on_segment(edge, p, q);
      if (l < best) {
         best = l;
         memcpy(out, q, sizeof q);
      }
   }
   return best;
}
typedef struct dn__surface { /* the mesh as given */
   const float *positions;   /* (N,3) */
   const uint32_t *triangle; /* (T,3) */
   size_t nodes, triangles;
} dn__surface;
static dn__surface dn__surface_of(const float *positions, size_t nodes, const uint32_t *triangle, size_t triangles)
{
   dn__surface m;
   m.positions = positions;
   m.triangle = triangle;
   m.nodes = nodes;
   m.triangles = triangles;
   return m;
}
static float dn__closest_on_surface(const dn__voxels *v, const dn__surface *mesh, const float p[3], float out[3])
{
   float best = DN__FAR, t[9], q[3];
   size_t i, k;
   for (i = 0; i < mesh->nodes; i++) { /* nodes too: not every one has a triangle */
      dn__to_grid(v, mesh->positions + 3 * i, q);
      if (dn__apart(q, p) < best) {
         best = dn__apart(q, p);
         memcpy(out, q, sizeof q);
      }
   }
   for (i = 0; i < mesh->triangles; i++) {
      float l, reach = best;
      for (k = 0; k < 3; k++) {
         dn__to_grid(v, mesh->positions + 3 * (size_t)mesh->triangle[3 * i + k], t + 3 * k);
         reach += k == 0 ? 0.0f : dn__apart(t, t + 3 * k);
      }
      if (dn__apart(t, p) > reach) continue; /* no point of it is that near */
      l = dn__closest_on_triangle(t, p, q);
      if (l < best) {
         best = l;
         memcpy(out, q, sizeof q);
      }
   }
   return best;
}
/* seed: (cell, segment) pairs, at most `room`; point (6) becomes the source when the segments are all outside */
static size_t dn__seed(const dn__voxels *v, const dn__surface *mesh, dn__source *s, uint32_t *seed, size_t room, float point[6])
{
   size_t seeds = 0, k, i, best = 0, step;
   float least = DN__FAR, centre[3], q[3], outside[3] = { 0.0f, 0.0f, 0.0f };
   for (k = 0; k < s->count; k++) {
      const float *a = s->segment + 6 * k;
      float length = dn__apart(a, a + 3);
      size_t steps = length > 0.0f ? (length < 4000.0f ? 2 * (size_t)length + 2 : 8000) : 0;
      uint32_t last = DN__NONE;
      for (step = 0; step <= steps; step++) {
         float t = steps ? (float)step / (float)steps : 0.0f;
         size_t at, j;
         for (j = 0; j < 3; j++) q[j] = a[j] + t * (a[j + 3] - a[j]);
         if (!dn__in_grid(v, q)) continue;
         at = dn__cell_at(v, q);
         if (!v->solid[at] || v->id_of[at] == last || seeds == room) continue;
         last = v->id_of[at];
         seed[2 * seeds] = last;
         seed[2 * seeds + 1] = (uint32_t)k;
         seeds++;
      }
   }
   s->gap = 0.0f;
   if (seeds > 0) return seeds;
   for (k = 0; k < s->count; k++) /* the segments' point that the solid is nearest to */
      for (i = 0; i < v->count; i++) {
         float d;
         dn__centre(v->place[i], centre);
         d = dn__closest_on_segment(s->segment + 6 * k, centre, q);
         if (d < least) {
            least = d;
            memcpy(outside, q, sizeof q);
         }
      }
   memcpy(point, outside, sizeof outside);
   (void)dn__closest_on_surface(v, mesh, outside, point);
   least = DN__FAR;
   for (i = 0; i < v->count; i++) { /* its cell; the nearest, should rounding have put it beside one */
      float d;
      dn__centre(v->place[i], centre);
      d = dn__apart(centre, point);
      if (d < least) least = d, best = i;
   }
   dn__centre(v->place[best], centre);
   for (k = 0; k < 3; k++) {
      float lo = centre[k] - 0.499f, hi = centre[k] + 0.499f;
      point[k] = point[k] < lo ? lo : (point[k] > hi ? hi : point[k]);
      point[k + 3] = point[k];
   }
   s->gap = dn__apart(point, outside);
   s->segment = point;
   s->count = 1;
   seed[0] = (uint32_t)best;
   seed[1] = 0;
   return 1;
}

/* --- the job: one search per joint, columns of (N,S) */
typedef struct dn__geodesic_job {
   const dn__voxels *v;
   dn__front *front;            /* (workers) */
   uint32_t *seed;              /* (workers, 2 DN__SEEDS) */
   dn__surface mesh;
   const float *joints;
   size_t joint_count, first;
   const float *segment;        /* voxel binding: all bones in grid coordinates, or NULL: the joints themselves */
   const uint32_t *bone_first;  /* (S+1) */
   float *distance;             /* (N,S) */
} dn__geodesic_job;
#define DN__SEEDS 8192u

static void dn__geodesic_joint(const dn__geodesic_job *job, size_t joint, dn__front *f, uint32_t *seed)
{
   const dn__voxels *v = job->v;
   dn__source s;
   float own[6], point[6];
   size_t seeds, i;
   uint32_t hint = DN__NONE;
   int across = 0;
   if (job->segment) {
      s.segment = job->segment + 6 * (size_t)job->bone_first[joint];
      s.count = job->bone_first[joint + 1] - job->bone_first[joint];
   } else {
      dn__to_grid(v, job->joints + 3 * joint, own);
      memcpy(own + 3, own, 3 * sizeof *own);
      s.segment = own;
      s.count = 1;
   }
   seeds = dn__seed(v, &job->mesh, &s, seed, DN__SEEDS, point);
   dn__solve(v, f, &s, seed, seeds);
   for (i = 0; i < job->mesh.nodes; i++) {
      uint32_t home = v->node_id[i];
      float p[3], length;
      dn__to_grid(v, job->mesh.positions + 3 * i, p);
      if (f->state[home] == DN__CLOSED) length = dn__distance_at(v, f, &s, home, p);
      else {
         if (!across) dn__block_minima(v, f), across = 1;
         length = dn__distance_across(v, f, p, &hint);
      }
      job->distance[i * job->joint_count + joint] = (float)((double)(length + s.gap) * v->cell);
   }
}
static void dn__geodesic_range(void *user, size_t begin, size_t end, unsigned worker)
{
   const dn__geodesic_job *job = (const dn__geodesic_job *)user;
   size_t s;
   for (s = begin; s < end; s++)
      dn__geodesic_joint(job, job->first + s, job->front + worker, job->seed + 2 * (size_t)DN__SEEDS * worker);
}
static void dn__geodesic_layout(dn__arena *a, dn__voxels *v, size_t nodes, size_t workers, dn__geodesic_job *job)
{
   dn__voxel_layout(a, v, nodes);
   job->front = (dn__front *)dn__take(a, workers, sizeof(dn__front));
   job->seed = (uint32_t *)dn__take(a, dn__mul(workers, 2 * (size_t)DN__SEEDS), sizeof(uint32_t));
}
/* all joints. Progress is asked between batches of joints, on the calling thread: the callback never runs beside a
   search, and cancelling needs no flag that two threads share. */
static dn_result dn__geodesic_all(dn__voxels *v, dn__arena *arena, dn__geodesic_job *job, const dn_parallel *parallel,
                                  const dn_progress *progress, const char *stage)
{
   unsigned w, workers = dn__workers(parallel);
   size_t batch = workers > 1 ? 4 * (size_t)workers : 1, done = 0;
   if (progress && progress->step && progress->step(progress->user, stage, 0.0f)) return DN_CANCELLED;
   dn__voxelise(v, job->mesh.positions, job->mesh.nodes, job->mesh.triangle, job->mesh.triangles);
   for (w = 0; w < workers; w++) job->front[w] = dn__front_layout(arena, v->count, v->blocks_used);
   if (arena->used > arena->size) return DN_TOO_SMALL;
   if (job->mesh.nodes == 0) return DN_OK; /* no solid, nothing to measure */
   job->v = v;
   while (done < job->joint_count) {
      size_t count = dn__min(batch, job->joint_count - done);
      job->first = done;
      dn__for(parallel, count, 1, dn__geodesic_range, job);
      done += count;
      if (progress && progress->step && progress->step(progress->user, stage, (float)done / (float)job->joint_count))
         return DN_CANCELLED;
   }
   return DN_OK;
}

DN_API size_t dn_geodesic_scratch(const float *positions, size_t nodes, size_t triangles, unsigned resolution, unsigned workers)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn__voxels v;
   dn__geodesic_job job;
   unsigned w, count = workers > 1 ? workers : 1;
   (void)triangles; /* not needed so far: triangles are marked one at a time */
   dn__voxel_grid(positions, nodes, resolution, &v);
   dn__geodesic_layout(&a, &v, nodes, count, &job);
   for (w = 0; w < count; w++) (void)dn__front_layout(&a, v.inner, v.blocks);
   return dn__gauge(&a);
}
DN_API dn_result dn_geodesic(const float *positions, size_t nodes, const uint32_t *triangle, size_t triangles,
                             const float *joints, size_t joint_count, unsigned resolution, float *distance,
                             size_t *solid_cells, float *cell, void *scratch, size_t scratch_bytes,
                             const dn_parallel *parallel, const dn_progress *progress)
{
   dn__arena arena = dn__arena_of(scratch, scratch_bytes);
   dn__voxels v;
   dn__geodesic_job job;
   dn_result result;
   memset(&job, 0, sizeof job);
   dn__voxel_grid(positions, nodes, resolution, &v);
   dn__geodesic_layout(&arena, &v, nodes, dn__workers(parallel), &job);
   if (!scratch || arena.used > arena.size) return DN_TOO_SMALL;
   job.mesh = dn__surface_of(positions, nodes, triangle, triangles);
   job.joints = joints;
   job.joint_count = joint_count;
   job.distance = distance;
   result = dn__geodesic_all(&v, &arena, &job, parallel, progress, "geodesic");
   if (solid_cells) *solid_cells = v.count;
   if (cell) *cell = (float)v.cell;
   return result;
}

/* --- voxel binding: a joint moves the bones from it to each of its children, so its distance is that to the nearest of
   them; a joint without children is a point */
typedef struct dn__bind_parts {
   float *distance;      /* (N,S) */
   float *segment;       /* (2S,6) */
   uint32_t *bone_first; /* (S+1) */
   dn__geodesic_job job;
} dn__bind_parts;
static void dn__bind_layout(dn__arena *a, dn__voxels *v, size_t nodes, size_t joint_count, size_t workers, dn__bind_parts *b)
{
   b->distance = (float *)dn__take(a, dn__mul(nodes, joint_count), sizeof(float));
   b->segment = (float *)dn__take(a, dn__mul(joint_count, 12), sizeof(float));
   b->bone_first = (uint32_t *)dn__take(a, dn__add(joint_count, 1), sizeof(uint32_t));
   memset(&b->job, 0, sizeof b->job);
   dn__geodesic_layout(a, v, nodes, workers, &b->job);
}
DN_API size_t dn_voxel_bind_scratch(const float *positions, size_t nodes, size_t triangles, size_t joint_count,
                                    unsigned resolution, unsigned workers)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn__voxels v;
   dn__bind_parts b;
   unsigned w, count = workers > 1 ? workers : 1;
   (void)triangles;
   dn__voxel_grid(positions, nodes, resolution, &v);
   dn__bind_layout(&a, &v, nodes, joint_count, count, &b);
   for (w = 0; w < count; w++) (void)dn__front_layout(&a, v.inner, v.blocks);
   return dn__gauge(&a);
}
/* w = 1 / ((1-a) d + a d^2)^2 of one node, largest first, ties to the lower joint; row (S) distances in longest sides */
static void dn__bind_node(const float *row, size_t joints, double longest, double falloff, size_t influences,
                          uint32_t *joint, float *weight)
{
   double sum = 0.0;
   size_t kept = 0, s, k;
   for (s = 0; s < joints; s++) { /* insertion into the few that are kept: nearest first */
      if (kept == influences && !(row[s] < row[joint[kept - 1]])) continue;
      if (kept < influences) kept++;
      for (k = kept - 1; k > 0 && row[s] < row[joint[k - 1]]; k--) joint[k] = joint[k - 1];
      joint[k] = (uint32_t)s;
   }
   for (k = 0; k < influences; k++) {
      double d = k < kept ? (double)row[joint[k]] / longest : 0.0, fall;
      if (d < 1e-4) d = 1e-4; /* on the bone itself: all but the whole weight */
      fall = (1.0 - falloff) * d + falloff * d * d;
      weight[k] = k < kept ? (float)(1e-8 / (fall * fall)) : 0.0f;
      if (k >= kept) joint[k] = 0;
      sum += (double)weight[k];
   }
   for (k = 0; k < influences; k++) weight[k] = (float)((double)weight[k] / sum);
}
DN_API dn_result dn_voxel_bind(const float *positions, size_t nodes, const uint32_t *triangle, size_t triangles,
                               const float *joints, const int32_t *parents, size_t joint_count, unsigned resolution,
                               float falloff, size_t influences, uint32_t *joint, float *weight, void *scratch,
                               size_t scratch_bytes, const dn_parallel *parallel, const dn_progress *progress)
{
   dn__arena arena = dn__arena_of(scratch, scratch_bytes);
   dn__voxels v;
   dn__bind_parts b;
   dn_result result;
   size_t s, c, i;
   uint32_t bones = 0;
   double longest;
   DN_ASSERT(joint_count > 0 && influences > 0);
   dn__voxel_grid(positions, nodes, resolution, &v);
   dn__bind_layout(&arena, &v, nodes, joint_count, dn__workers(parallel), &b);
   if (!scratch || arena.used > arena.size) return DN_TOO_SMALL;

   memset(b.bone_first, 0, (joint_count + 1) * sizeof *b.bone_first);
   for (s = 0; s < joint_count; s++) /* children counted, then rows started, then filled */
      if (parents[s] >= 0 && (size_t)parents[s] < joint_count) b.bone_first[parents[s]]++;
   for (s = 0; s < joint_count; s++) {
      uint32_t count = b.bone_first[s] ? b.bone_first[s] : 1;
      float own[3];
      dn__to_grid(&v, joints + 3 * s, own);
      for (c = bones; c < bones + count; c++) {
         memcpy(b.segment + 6 * c, own, sizeof own);
         memcpy(b.segment + 6 * c + 3, own, sizeof own);
      }
      b.bone_first[s] = bones;
      bones += count;
   }
   for (s = 0; s < joint_count; s++)
      if (parents[s] >= 0 && (size_t)parents[s] < joint_count)
         dn__to_grid(&v, joints + 3 * s, b.segment + 6 * (size_t)b.bone_first[parents[s]]++ + 3);
   for (s = joint_count; s > 0; s--) b.bone_first[s] = b.bone_first[s - 1]; /* filled rows had moved to their ends */
   b.bone_first[0] = 0;
   for (s = 1; s <= joint_count; s++) /* rows of childless joints had not moved, which left them one short */
      if (b.bone_first[s] == b.bone_first[s - 1]) b.bone_first[s]++;

   b.job.mesh = dn__surface_of(positions, nodes, triangle, triangles);
   b.job.joints = joints;
   b.job.joint_count = joint_count;
   b.job.segment = b.segment;
   b.job.bone_first = b.bone_first;
   b.job.distance = b.distance;
   result = dn__geodesic_all(&v, &arena, &b.job, parallel, progress, "voxel bind");
   if (result != DN_OK) return result;
   longest = v.cell * (double)(resolution ? dn__min(resolution, 512) : 128);
   falloff = falloff > 0.0f ? (falloff < 1.0f ? falloff : 1.0f) : 0.0f;
   for (i = 0; i < nodes; i++)
      dn__bind_node(b.distance + i * joint_count, joint_count, longest, (double)falloff, influences, joint + i * influences,
                    weight + i * influences);
   return DN_OK;
}

/* ===================================================================================== >>kernels
   in       rows x (rows,in) with a stride; weights in panels (ceil(out/16), in, 16)    out  y = act(x W^T + bias)
   touches  nothing but y: no allocation, no statics; packing asks the processor once and notes the kernel
   read     dn__exp, dn__tanhshrink, dn__product_ref first; every fast text below is one of these again */

/* exp(x) = 2^n exp(r), n = floor(x log2 e + 1/2), r = x - n ln 2, and exp(r) = 1 + r + r^2 q(r), q fitted so that the
   relative error is least on |r| <= ln 2 / 2. Within 1 ulp of the true value on [-87.3, 88], exactly 1 at 0; beyond
   the range it saturates (exp(-87.3) = 1.2e-38 adds nothing to a softmax), NaN stays NaN. */
#define DN__EXP_LOW (-87.3f)
#define DN__EXP_HIGH 88.0f
#define DN__LOG2E 1.44269504f
#define DN__LN2_HIGH 0.693359375f /* 9 bits: n times this is exact */
#define DN__LN2_LOW (-2.12194440e-4f)
#define DN__EXP_0 0.499999926293f
#define DN__EXP_1 0.166665087146f
#define DN__EXP_2 0.041668528324f
#define DN__EXP_3 0.008370135025f
#define DN__EXP_4 0.001381166006f
static int dn__nan(float x) /* by bits, as dn__finite */
{
   uint32_t u;
   memcpy(&u, &x, 4);
   return (u & 0x7fffffffu) > 0x7f800000u;
}
static float dn__exp(float x)
{
   float t, n, r, q, scale;
   int k;
   uint32_t bits;
   if (dn__nan(x)) return x;
   if (x < DN__EXP_LOW) x = DN__EXP_LOW;
   if (x > DN__EXP_HIGH) x = DN__EXP_HIGH;
   t = x * DN__LOG2E + 0.5f;
   k = (int)t;
   if ((float)k > t) k--; /* floor */
   n = (float)k;
   r = x - n * DN__LN2_HIGH - n * DN__LN2_LOW;
   q = (((DN__EXP_4 * r + DN__EXP_3) * r + DN__EXP_2) * r + DN__EXP_1) * r + DN__EXP_0;
   bits = (uint32_t)(k + 127) << 23;
   memcpy(&scale, &bits, 4);
   return (q * (r * r) + r + 1.0f) * scale;
}

/* x - tanh x. Up to 0.625 from its own series, x^3 p(x^2), so that small values keep their digits (relative error
   3e-7); above, from tanh |x| = 1 - 2t / (1 + t), t = exp(-2|x|). tanh is taken from the same two: absolute error
   below 1e-7, odd, exactly 0 at 0 and 1 from 9.1 on. */
#define DN__TANH_SMALL 0.625f
#define DN__TANH_0 0.333333289484f
#define DN__TANH_1 (-0.133327700768f)
#define DN__TANH_2 0.05385095261f
#define DN__TANH_3 (-0.020997354014f)
#define DN__TANH_4 0.00609693706f
static float dn__shrink_small(float x) /* x - tanh x, |x| <= DN__TANH_SMALL */
{
   float z = x * x;
   return ((((DN__TANH_4 * z + DN__TANH_3) * z + DN__TANH_2) * z + DN__TANH_1) * z + DN__TANH_0) * z * x;
}
static float dn__tanh_large(float x)
{
   float t = dn__exp(-2.0f * DN_FABSF(x)), y = 1.0f - 2.0f * t / (1.0f + t);
   return x < 0 ? -y : y;
}
static float dn__tanh(float x) { return DN_FABSF(x) < DN__TANH_SMALL ? x - dn__shrink_small(x) : dn__tanh_large(x); }
static float dn__tanhshrink(float x)
{
   return DN_FABSF(x) < DN__TANH_SMALL ? dn__shrink_small(x) : x - dn__tanh_large(x);
}
static float dn__leaky(float x) { return x < 0 ? 0.2f * x : x; }
static float dn__activate(float x, dn_activation activation) /* one number; softmax is over a row */
{
   switch (activation) {
   case DN_ACT_TANH: return dn__tanh(x);
   case DN_ACT_RELU: return x < 0 ? 0 : x; /* NaN stays NaN */
   case DN_ACT_LEAKYRELU: return dn__leaky(x);
   case DN_ACT_TANHSHRINK: return dn__tanhshrink(x);
   case DN_ACT_NONE:
   case DN_ACT_SOFTMAX:
   default: return x;
   }
}
static void dn__softmax(float *row, size_t count) /* softmax_c = exp(x_c - max) / sum exp(x - max) */
{
   float most = row[0], sum = 0;
   size_t c;
   for (c = 1; c < count; c++) most = row[c] > most ? row[c] : most;
   for (c = 0; c < count; c++) sum += row[c] = dn__exp(row[c] - most);
   for (c = 0; c < count; c++) row[c] /= sum;
}

/* y_ro = act( sum_c x_rc W_oc + b_o ), rows begin to end - 1 */
static void dn__product_ref(const dn_linear *l, const float *x, size_t x_stride, float *y, size_t y_stride,
                            size_t begin, size_t end)
{
   size_t r, o, c;
   for (r = begin; r < end; r++) {
      const float *row = x + r * x_stride; /* (in) */
      float *to = y + r * y_stride;        /* (out) */
      for (o = 0; o < l->out; o++) {
         const float *w = l->panels + (o / DN_PANEL * l->in) * DN_PANEL + o % DN_PANEL; /* W_oc at w[16 c] */
         float sum = l->bias[o];
         for (c = 0; c < l->in; c++) sum += row[c] * w[c * DN_PANEL];
         to[o] = dn__activate(sum, l->activation);
      }
      if (l->activation == DN_ACT_SOFTMAX) dn__softmax(to, l->out);
   }
}

/* --- what this compiler can build. x86 texts carry their own target attribute, so that no compiler flag is needed
   and the processor is asked at run time; NEON and WebAssembly SIMD are there or not when compiling. */
#if !defined(DN_NO_SIMD)
   #if defined(_MSC_VER) && !defined(__clang__) && (defined(_M_X64) || defined(_M_IX86))
      #include <intrin.h>
      #include <immintrin.h>
      #define DN__HAS_AVX2
      #define DN__TARGET_AVX2
      #if defined(_M_X64) && _MSC_VER >= 1920
         #define DN__HAS_AVX512
         #define DN__TARGET_AVX512
      #endif
   #elif (defined(__GNUC__) || defined(__clang__)) && (defined(__x86_64__) || defined(__i386__))
      #include <immintrin.h>
      /* gcc for Windows aligns the stack to 16 bytes only, yet spills wider registers with aligned moves (gcc bug
         54412): there the SSE text runs */
      #if !defined(_WIN32) || defined(__clang__)
         #include <cpuid.h>
         #define DN__HAS_AVX2
         #define DN__TARGET_AVX2 __attribute__((target("avx2,fma")))
         #if defined(__x86_64__) /* the 32 registers that its tile fills exist in 64-bit mode only */
            #define DN__HAS_AVX512
            #define DN__TARGET_AVX512 __attribute__((target("avx2,fma,avx512f,avx512vl,avx512dq,avx512bw")))
         #endif
      #endif
   #endif
   #if defined(__aarch64__) || defined(_M_ARM64)
      #include <arm_neon.h>
      #define DN__F4_NEON
   #elif defined(__wasm_simd128__)
      #include <wasm_simd128.h>
      #define DN__F4_WASM
   #elif defined(__SSE2__) || defined(_M_X64) || (defined(_M_IX86_FP) && _M_IX86_FP >= 2)
      #include <emmintrin.h>
      #define DN__F4_SSE
   #endif
#endif
#if defined(__GNUC__) || defined(__clang__)
   #define DN__INLINE __inline__ __attribute__((always_inline))
#elif defined(_MSC_VER)
   #define DN__INLINE __forceinline
#else
   #define DN__INLINE inline
#endif
#define DN__GRAIN ((size_t)168) /* rows a range of the parallel loop: a multiple of every tile height below */

/* Each text offers these. A tile is `rows` rows of x times one or two panels; every y adds its
   terms c = 0 .. in-1 in one order, whatever the tile, so results do not depend on how rows are grouped. */
typedef struct dn__kernel {
   size_t rows, panels; /* of its tile */
   /* y (rows, 16 panels) = x (rows,in) w + bias; w: panels of (in,16) */
   void (*tile)(const float *x, size_t x_stride, size_t in, const float *w, const float *bias, size_t panels,
                float *y, size_t y_stride);
   /* the same for one row and one panel */
   void (*row)(const float *x, size_t in, const float *w, const float *bias, float *y);
   /* y (rows, columns) = act(y); columns a multiple of 16; not softmax */
   void (*activate)(float *y, size_t y_stride, size_t rows, size_t columns, dn_activation activation);
   /* >>attention: dn__attend_ref is the specification */
   void (*attend)(const dn_gat *b, const dn_graph *g, const float *z, float *y, size_t y_stride, size_t begin,
                  size_t end);
} dn__kernel;
#define DN__EACH3(X) X(0) X(1) X(2)
#define DN__EACH6(X) DN__EACH3(X) X(3) X(4) X(5)
#define DN__EACH14(X) DN__EACH6(X) X(6) X(7) X(8) X(9) X(10) X(11) X(12) X(13)

#ifdef DN__HAS_AVX2
/* --- AVX2 + FMA, 8 lanes */
DN__TARGET_AVX2 static DN__INLINE __m256 dn__exp_avx2(__m256 x) /* dn__exp */
{
   __m256 n, r, q;
   __m256i scale;
   x = _mm256_max_ps(_mm256_set1_ps(DN__EXP_LOW), x); /* of (a, NaN) these give NaN */
   x = _mm256_min_ps(_mm256_set1_ps(DN__EXP_HIGH), x);
   n = _mm256_floor_ps(_mm256_fmadd_ps(x, _mm256_set1_ps(DN__LOG2E), _mm256_set1_ps(0.5f)));
   r = _mm256_fnmadd_ps(n, _mm256_set1_ps(DN__LN2_HIGH), x);
   r = _mm256_fnmadd_ps(n, _mm256_set1_ps(DN__LN2_LOW), r);
   q = _mm256_fmadd_ps(_mm256_set1_ps(DN__EXP_4), r, _mm256_set1_ps(DN__EXP_3));
   q = _mm256_fmadd_ps(q, r, _mm256_set1_ps(DN__EXP_2));
   q = _mm256_fmadd_ps(q, r, _mm256_set1_ps(DN__EXP_1));
   q = _mm256_fmadd_ps(q, r, _mm256_set1_ps(DN__EXP_0));
   q = _mm256_add_ps(_mm256_fmadd_ps(q, _mm256_mul_ps(r, r), r), _mm256_set1_ps(1.0f));
   scale = _mm256_slli_epi32(_mm256_add_epi32(_mm256_cvttps_epi32(n), _mm256_set1_epi32(127)), 23);
   return _mm256_mul_ps(q, _mm256_castsi256_ps(scale));
}
DN__TARGET_AVX2 static DN__INLINE __m256 dn__tanh_avx2(__m256 x, int shrink) /* dn__tanh or dn__tanhshrink */
{
   const __m256 sign = _mm256_set1_ps(-0.0f), one = _mm256_set1_ps(1.0f);
   __m256 size = _mm256_andnot_ps(sign, x), z = _mm256_mul_ps(x, x), s, t, small;
   small = _mm256_cmp_ps(size, _mm256_set1_ps(DN__TANH_SMALL), _CMP_LT_OQ);
   s = _mm256_fmadd_ps(_mm256_set1_ps(DN__TANH_4), z, _mm256_set1_ps(DN__TANH_3));
   s = _mm256_fmadd_ps(s, z, _mm256_set1_ps(DN__TANH_2));
   s = _mm256_fmadd_ps(s, z, _mm256_set1_ps(DN__TANH_1));
   s = _mm256_fmadd_ps(s, z, _mm256_set1_ps(DN__TANH_0));
   s = _mm256_mul_ps(_mm256_mul_ps(s, z), x); /* x - tanh x, small x */
   t = dn__exp_avx2(_mm256_mul_ps(size, _mm256_set1_ps(-2.0f)));
   t = _mm256_sub_ps(one, _mm256_div_ps(_mm256_add_ps(t, t), _mm256_add_ps(one, t)));
   t = _mm256_or_ps(t, _mm256_and_ps(sign, x)); /* tanh x, large x */
   return shrink ? _mm256_blendv_ps(_mm256_sub_ps(x, t), s, small) : _mm256_blendv_ps(t, _mm256_sub_ps(x, s), small);
}
DN__TARGET_AVX2 static DN__INLINE __m256 dn__leaky_avx2(__m256 x)
{
   return _mm256_max_ps(_mm256_mul_ps(x, _mm256_set1_ps(0.2f)), x);
}
DN__TARGET_AVX2 static DN__INLINE __m256 dn__act_avx2(__m256 x, dn_activation activation)
{
   switch (activation) {
   case DN_ACT_TANH: return dn__tanh_avx2(x, 0);
   case DN_ACT_RELU: return _mm256_max_ps(_mm256_setzero_ps(), x);
   case DN_ACT_LEAKYRELU: return dn__leaky_avx2(x);
   case DN_ACT_TANHSHRINK: return dn__tanh_avx2(x, 1);
   case DN_ACT_NONE:
   case DN_ACT_SOFTMAX:
   default: return x;
   }
}
DN__TARGET_AVX2 static void dn__activate_avx2(float *y, size_t y_stride, size_t rows, size_t columns,
                                              dn_activation activation)
{
   size_t r, c;
   for (r = 0; r < rows; r++)
      for (c = 0; c < columns; c += 8)
         _mm256_storeu_ps(y + r * y_stride + c, dn__act_avx2(_mm256_loadu_ps(y + r * y_stride + c), activation));
}
/* 6 rows x 16 columns: 12 sums, 2 weights and 1 broadcast x fill 15 of the 16 registers */
DN__TARGET_AVX2 static void dn__tile_avx2(const float *x, size_t x_stride, size_t in, const float *w,
                                          const float *bias, size_t panels, float *y, size_t y_stride)
{
   const float *x0 = x, *x3 = x + 3 * x_stride;
   __m256 w0, w1, v;
   size_t c;
   (void)panels; /* always 1 */
   w0 = _mm256_loadu_ps(bias);
   w1 = _mm256_loadu_ps(bias + 8);
#define DN__START(r) __m256 a##r = w0, b##r = w1;
#define DN__STEP(r)                                                                                          \
   v = _mm256_broadcast_ss((r < 3 ? x0 : x3) + r % 3 * x_stride + c);                                        \
   a##r = _mm256_fmadd_ps(v, w0, a##r);                                                                      \
   b##r = _mm256_fmadd_ps(v, w1, b##r);
#define DN__STORE(r)                                                                                         \
   _mm256_storeu_ps(y + r * y_stride, a##r);                                                                 \
   _mm256_storeu_ps(y + r * y_stride + 8, b##r);
   {
      DN__EACH6(DN__START)
      for (c = 0; c < in; c++, w += DN_PANEL) {
         w0 = _mm256_loadu_ps(w);
         w1 = _mm256_loadu_ps(w + 8);
         DN__EACH6(DN__STEP)
      }
      DN__EACH6(DN__STORE)
   }
#undef DN__START
#undef DN__STEP
#undef DN__STORE
}
DN__TARGET_AVX2 static void dn__row_avx2(const float *x, size_t in, const float *w, const float *bias, float *y)
{
   __m256 a = _mm256_loadu_ps(bias), b = _mm256_loadu_ps(bias + 8);
   size_t c;
   for (c = 0; c < in; c++, w += DN_PANEL) {
      __m256 v = _mm256_broadcast_ss(x + c);
      a = _mm256_fmadd_ps(v, _mm256_loadu_ps(w), a);
      b = _mm256_fmadd_ps(v, _mm256_loadu_ps(w + 8), b);
   }
   _mm256_storeu_ps(y, a);
   _mm256_storeu_ps(y + 8, b);
}
#endif /* DN__HAS_AVX2 */

#ifdef DN__HAS_AVX512
/* --- AVX-512, 16 lanes. Some unmasked intrinsics of gcc's header start from a variable that it then warns about
   (gcc bug 105593); with a mask of ones they compile to the same instruction. */
#define DN__ALL ((__mmask16)0xffff)
DN__TARGET_AVX512 static DN__INLINE __m512 dn__exp_avx512(__m512 x) /* dn__exp */
{
   __m512 n, r, q;
   x = _mm512_maskz_max_ps(DN__ALL, _mm512_set1_ps(DN__EXP_LOW), x); /* of (a, NaN) these give NaN */
   x = _mm512_maskz_min_ps(DN__ALL, _mm512_set1_ps(DN__EXP_HIGH), x);
   n = _mm512_floor_ps(_mm512_fmadd_ps(x, _mm512_set1_ps(DN__LOG2E), _mm512_set1_ps(0.5f)));
   r = _mm512_fnmadd_ps(n, _mm512_set1_ps(DN__LN2_HIGH), x);
   r = _mm512_fnmadd_ps(n, _mm512_set1_ps(DN__LN2_LOW), r);
   q = _mm512_fmadd_ps(_mm512_set1_ps(DN__EXP_4), r, _mm512_set1_ps(DN__EXP_3));
   q = _mm512_fmadd_ps(q, r, _mm512_set1_ps(DN__EXP_2));
   q = _mm512_fmadd_ps(q, r, _mm512_set1_ps(DN__EXP_1));
   q = _mm512_fmadd_ps(q, r, _mm512_set1_ps(DN__EXP_0));
   q = _mm512_add_ps(_mm512_fmadd_ps(q, _mm512_mul_ps(r, r), r), _mm512_set1_ps(1.0f));
   return _mm512_maskz_scalef_ps(DN__ALL, q, n); /* q 2^n */
}
DN__TARGET_AVX512 static DN__INLINE __m512 dn__tanh_avx512(__m512 x, int shrink) /* dn__tanh or dn__tanhshrink */
{
   const __m512 sign = _mm512_set1_ps(-0.0f), one = _mm512_set1_ps(1.0f);
   __m512 size = _mm512_andnot_ps(sign, x), z = _mm512_mul_ps(x, x), s, t;
   __mmask16 small = _mm512_cmp_ps_mask(size, _mm512_set1_ps(DN__TANH_SMALL), _CMP_LT_OQ);
   s = _mm512_fmadd_ps(_mm512_set1_ps(DN__TANH_4), z, _mm512_set1_ps(DN__TANH_3));
   s = _mm512_fmadd_ps(s, z, _mm512_set1_ps(DN__TANH_2));
   s = _mm512_fmadd_ps(s, z, _mm512_set1_ps(DN__TANH_1));
   s = _mm512_fmadd_ps(s, z, _mm512_set1_ps(DN__TANH_0));
   s = _mm512_mul_ps(_mm512_mul_ps(s, z), x); /* x - tanh x, small x */
   t = dn__exp_avx512(_mm512_mul_ps(size, _mm512_set1_ps(-2.0f)));
   t = _mm512_sub_ps(one, _mm512_div_ps(_mm512_add_ps(t, t), _mm512_add_ps(one, t)));
   t = _mm512_or_ps(t, _mm512_and_ps(sign, x)); /* tanh x, large x */
   return shrink ? _mm512_mask_blend_ps(small, _mm512_sub_ps(x, t), s)
                 : _mm512_mask_blend_ps(small, t, _mm512_sub_ps(x, s));
}
DN__TARGET_AVX512 static DN__INLINE __m512 dn__act_avx512(__m512 x, dn_activation activation)
{
   switch (activation) {
   case DN_ACT_TANH: return dn__tanh_avx512(x, 0);
   case DN_ACT_RELU: return _mm512_maskz_max_ps(DN__ALL, _mm512_setzero_ps(), x);
   case DN_ACT_LEAKYRELU: return _mm512_maskz_max_ps(DN__ALL, _mm512_mul_ps(x, _mm512_set1_ps(0.2f)), x);
   case DN_ACT_TANHSHRINK: return dn__tanh_avx512(x, 1);
   case DN_ACT_NONE:
   case DN_ACT_SOFTMAX:
   default: return x;
   }
}
DN__TARGET_AVX512 static void dn__activate_avx512(float *y, size_t y_stride, size_t rows, size_t columns,
                                                  dn_activation activation)
{
   size_t r, c;
   for (r = 0; r < rows; r++)
      for (c = 0; c < columns; c += 16)
         _mm512_storeu_ps(y + r * y_stride + c, dn__act_avx512(_mm512_loadu_ps(y + r * y_stride + c), activation));
}
/* 14 rows x 32 columns (two panels): 28 sums, 2 weights and 1 broadcast x fill 31 of the 32 registers. Four row
   pointers, each serving rows 0, 1, 2, 3 strides away, keep the addresses in registers too. */
DN__TARGET_AVX512 static void dn__tile_avx512(const float *x, size_t x_stride, size_t in, const float *w,
                                              const float *bias, size_t panels, float *y, size_t y_stride)
{
   const float *x0 = x, *x4 = x + 4 * x_stride, *x8 = x + 8 * x_stride, *x12 = x + 12 * x_stride;
   const float *u = w + in * DN_PANEL; /* the second panel */
   __m512 w0, w1, v;
   size_t c;
#define DN__X(r) ((r < 4 ? x0 : r < 8 ? x4 : r < 12 ? x8 : x12) + r % 4 * x_stride)
#define DN__START(r) __m512 a##r = w0;
#define DN__START2(r) __m512 b##r = w1;
#define DN__STEP(r) a##r = _mm512_fmadd_ps(_mm512_set1_ps(*DN__X(r)), w0, a##r);
#define DN__STEP2(r)                                                                                         \
   v = _mm512_set1_ps(*DN__X(r));                                                                            \
   a##r = _mm512_fmadd_ps(v, w0, a##r);                                                                      \
   b##r = _mm512_fmadd_ps(v, w1, b##r);
#define DN__STORE(r) _mm512_storeu_ps(y + r * y_stride, a##r);
#define DN__STORE2(r) _mm512_storeu_ps(y + r * y_stride + 16, b##r);
   w0 = _mm512_loadu_ps(bias);
   if (panels == 2) {
      w1 = _mm512_loadu_ps(bias + 16);
      {
         DN__EACH14(DN__START)
         DN__EACH14(DN__START2)
         for (c = 0; c < in; c++, w += DN_PANEL, u += DN_PANEL, x0++, x4++, x8++, x12++) {
            w0 = _mm512_loadu_ps(w);
            w1 = _mm512_loadu_ps(u);
            DN__EACH14(DN__STEP2)
         }
         DN__EACH14(DN__STORE)
         DN__EACH14(DN__STORE2)
      }
   } else {
      DN__EACH14(DN__START)
      for (c = 0; c < in; c++, w += DN_PANEL, x0++, x4++, x8++, x12++) {
         w0 = _mm512_loadu_ps(w);
         DN__EACH14(DN__STEP)
      }
      DN__EACH14(DN__STORE)
   }
#undef DN__X
#undef DN__START
#undef DN__START2
#undef DN__STEP
#undef DN__STEP2
#undef DN__STORE
#undef DN__STORE2
}
DN__TARGET_AVX512 static void dn__row_avx512(const float *x, size_t in, const float *w, const float *bias, float *y)
{
   __m512 a = _mm512_loadu_ps(bias);
   size_t c;
   for (c = 0; c < in; c++, w += DN_PANEL) a = _mm512_fmadd_ps(_mm512_set1_ps(x[c]), _mm512_loadu_ps(w), a);
   _mm512_storeu_ps(y, a);
}
#endif /* DN__HAS_AVX512 */

#if defined(DN__F4_NEON) || defined(DN__F4_WASM) || defined(DN__F4_SSE)
#define DN__HAS_F4
/* --- four lanes: NEON, WebAssembly SIMD and SSE2 share one text over these few operations.
   max, min and floor of NaN are NaN when it is the second operand; pick(a, b, p, q) is a < b ? p : q. */
   #if defined(DN__F4_NEON)
      #define DN__F4_KERNEL DN_KERNEL_NEON
      #define DN__F4_ROWS 6 /* 24 sums of 32 registers */
      #define DN__F4_EACH DN__EACH6
typedef float32x4_t dn__f4;
static DN__INLINE dn__f4 dn__f4_load(const float *p) { return vld1q_f32(p); }
static DN__INLINE void dn__f4_store(float *p, dn__f4 a) { vst1q_f32(p, a); }
static DN__INLINE dn__f4 dn__f4_all(float a) { return vdupq_n_f32(a); }
static DN__INLINE dn__f4 dn__f4_add(dn__f4 a, dn__f4 b) { return vaddq_f32(a, b); }
static DN__INLINE dn__f4 dn__f4_sub(dn__f4 a, dn__f4 b) { return vsubq_f32(a, b); }
static DN__INLINE dn__f4 dn__f4_mul(dn__f4 a, dn__f4 b) { return vmulq_f32(a, b); }
static DN__INLINE dn__f4 dn__f4_div(dn__f4 a, dn__f4 b) { return vdivq_f32(a, b); }
static DN__INLINE dn__f4 dn__f4_fma(dn__f4 a, dn__f4 b, dn__f4 c) { return vfmaq_f32(c, a, b); } /* ab + c */
static DN__INLINE dn__f4 dn__f4_max(dn__f4 a, dn__f4 b) { return vmaxq_f32(a, b); }
static DN__INLINE dn__f4 dn__f4_min(dn__f4 a, dn__f4 b) { return vminq_f32(a, b); }
static DN__INLINE dn__f4 dn__f4_floor(dn__f4 a) { return vrndmq_f32(a); }
static DN__INLINE dn__f4 dn__f4_abs(dn__f4 a) { return vabsq_f32(a); }
static DN__INLINE dn__f4 dn__f4_pick(dn__f4 a, dn__f4 b, dn__f4 p, dn__f4 q)
{
   return vbslq_f32(vcltq_f32(a, b), p, q);
}
static DN__INLINE dn__f4 dn__f4_power(dn__f4 n) /* 2^n, n whole */
{
   return vreinterpretq_f32_s32(vshlq_n_s32(vaddq_s32(vcvtq_s32_f32(n), vdupq_n_s32(127)), 23));
}
   #elif defined(DN__F4_WASM)
      #define DN__F4_KERNEL DN_KERNEL_WASM
      #define DN__F4_ROWS 3 /* 12 sums of the 16 registers that most engines have */
      #define DN__F4_EACH DN__EACH3
typedef v128_t dn__f4;
static DN__INLINE dn__f4 dn__f4_load(const float *p) { return wasm_v128_load(p); }
static DN__INLINE void dn__f4_store(float *p, dn__f4 a) { wasm_v128_store(p, a); }
static DN__INLINE dn__f4 dn__f4_all(float a) { return wasm_f32x4_splat(a); }
static DN__INLINE dn__f4 dn__f4_add(dn__f4 a, dn__f4 b) { return wasm_f32x4_add(a, b); }
static DN__INLINE dn__f4 dn__f4_sub(dn__f4 a, dn__f4 b) { return wasm_f32x4_sub(a, b); }
static DN__INLINE dn__f4 dn__f4_mul(dn__f4 a, dn__f4 b) { return wasm_f32x4_mul(a, b); }
static DN__INLINE dn__f4 dn__f4_div(dn__f4 a, dn__f4 b) { return wasm_f32x4_div(a, b); }
static DN__INLINE dn__f4 dn__f4_fma(dn__f4 a, dn__f4 b, dn__f4 c) { return wasm_f32x4_add(wasm_f32x4_mul(a, b), c); }
static DN__INLINE dn__f4 dn__f4_max(dn__f4 a, dn__f4 b) { return wasm_f32x4_max(a, b); }
static DN__INLINE dn__f4 dn__f4_min(dn__f4 a, dn__f4 b) { return wasm_f32x4_min(a, b); }
static DN__INLINE dn__f4 dn__f4_floor(dn__f4 a) { return wasm_f32x4_floor(a); }
static DN__INLINE dn__f4 dn__f4_abs(dn__f4 a) { return wasm_f32x4_abs(a); }
static DN__INLINE dn__f4 dn__f4_pick(dn__f4 a, dn__f4 b, dn__f4 p, dn__f4 q)
{
   return wasm_v128_bitselect(p, q, wasm_f32x4_lt(a, b));
}
static DN__INLINE dn__f4 dn__f4_power(dn__f4 n) /* 2^n, n whole */
{
   return wasm_i32x4_shl(wasm_i32x4_add(wasm_i32x4_trunc_sat_f32x4(n), wasm_i32x4_splat(127)), 23);
}
   #else
      #define DN__F4_KERNEL DN_KERNEL_SSE
      #define DN__F4_ROWS 3
      #define DN__F4_EACH DN__EACH3
typedef __m128 dn__f4;
static DN__INLINE dn__f4 dn__f4_load(const float *p) { return _mm_loadu_ps(p); }
static DN__INLINE void dn__f4_store(float *p, dn__f4 a) { _mm_storeu_ps(p, a); }
static DN__INLINE dn__f4 dn__f4_all(float a) { return _mm_set1_ps(a); }
static DN__INLINE dn__f4 dn__f4_add(dn__f4 a, dn__f4 b) { return _mm_add_ps(a, b); }
static DN__INLINE dn__f4 dn__f4_sub(dn__f4 a, dn__f4 b) { return _mm_sub_ps(a, b); }
static DN__INLINE dn__f4 dn__f4_mul(dn__f4 a, dn__f4 b) { return _mm_mul_ps(a, b); }
static DN__INLINE dn__f4 dn__f4_div(dn__f4 a, dn__f4 b) { return _mm_div_ps(a, b); }
static DN__INLINE dn__f4 dn__f4_fma(dn__f4 a, dn__f4 b, dn__f4 c) { return _mm_add_ps(_mm_mul_ps(a, b), c); }
static DN__INLINE dn__f4 dn__f4_max(dn__f4 a, dn__f4 b) { return _mm_max_ps(a, b); }
static DN__INLINE dn__f4 dn__f4_min(dn__f4 a, dn__f4 b) { return _mm_min_ps(a, b); }
static DN__INLINE dn__f4 dn__f4_floor(dn__f4 a) /* |a| < 2^31: SSE2 truncates only */
{
   __m128 t = _mm_cvtepi32_ps(_mm_cvttps_epi32(a));
   return _mm_sub_ps(t, _mm_and_ps(_mm_cmpgt_ps(t, a), _mm_set1_ps(1.0f)));
}
static DN__INLINE dn__f4 dn__f4_abs(dn__f4 a) { return _mm_andnot_ps(_mm_set1_ps(-0.0f), a); }
static DN__INLINE dn__f4 dn__f4_pick(dn__f4 a, dn__f4 b, dn__f4 p, dn__f4 q)
{
   __m128 less = _mm_cmplt_ps(a, b);
   return _mm_or_ps(_mm_and_ps(less, p), _mm_andnot_ps(less, q));
}
static DN__INLINE dn__f4 dn__f4_power(dn__f4 n) /* 2^n, n whole */
{
   return _mm_castsi128_ps(_mm_slli_epi32(_mm_add_epi32(_mm_cvttps_epi32(n), _mm_set1_epi32(127)), 23));
}
   #endif
static DN__INLINE dn__f4 dn__exp_f4(dn__f4 x) /* dn__exp */
{
   dn__f4 n, r, q;
   x = dn__f4_min(dn__f4_all(DN__EXP_HIGH), dn__f4_max(dn__f4_all(DN__EXP_LOW), x));
   n = dn__f4_floor(dn__f4_fma(x, dn__f4_all(DN__LOG2E), dn__f4_all(0.5f)));
   r = dn__f4_fma(n, dn__f4_all(-DN__LN2_HIGH), x);
   r = dn__f4_fma(n, dn__f4_all(-DN__LN2_LOW), r);
   q = dn__f4_fma(dn__f4_all(DN__EXP_4), r, dn__f4_all(DN__EXP_3));
   q = dn__f4_fma(q, r, dn__f4_all(DN__EXP_2));
   q = dn__f4_fma(q, r, dn__f4_all(DN__EXP_1));
   q = dn__f4_fma(q, r, dn__f4_all(DN__EXP_0));
   q = dn__f4_add(dn__f4_fma(q, dn__f4_mul(r, r), r), dn__f4_all(1.0f));
   return dn__f4_mul(q, dn__f4_power(n));
}
static DN__INLINE dn__f4 dn__tanh_f4(dn__f4 x, int shrink) /* dn__tanh or dn__tanhshrink */
{
   const dn__f4 zero = dn__f4_all(0.0f), one = dn__f4_all(1.0f), bend = dn__f4_all(DN__TANH_SMALL);
   dn__f4 size = dn__f4_abs(x), z = dn__f4_mul(x, x), s, t;
   s = dn__f4_fma(dn__f4_all(DN__TANH_4), z, dn__f4_all(DN__TANH_3));
   s = dn__f4_fma(s, z, dn__f4_all(DN__TANH_2));
   s = dn__f4_fma(s, z, dn__f4_all(DN__TANH_1));
   s = dn__f4_fma(s, z, dn__f4_all(DN__TANH_0));
   s = dn__f4_mul(dn__f4_mul(s, z), x); /* x - tanh x, small x */
   t = dn__exp_f4(dn__f4_mul(size, dn__f4_all(-2.0f)));
   t = dn__f4_sub(one, dn__f4_div(dn__f4_add(t, t), dn__f4_add(one, t)));
   t = dn__f4_pick(x, zero, dn__f4_sub(zero, t), t); /* tanh x, large x */
   return shrink ? dn__f4_pick(size, bend, s, dn__f4_sub(x, t)) : dn__f4_pick(size, bend, dn__f4_sub(x, s), t);
}
static DN__INLINE dn__f4 dn__leaky_f4(dn__f4 x) { return dn__f4_max(dn__f4_mul(x, dn__f4_all(0.2f)), x); }
static DN__INLINE dn__f4 dn__act_f4(dn__f4 x, dn_activation activation)
{
   switch (activation) {
   case DN_ACT_TANH: return dn__tanh_f4(x, 0);
   case DN_ACT_RELU: return dn__f4_max(dn__f4_all(0.0f), x);
   case DN_ACT_LEAKYRELU: return dn__leaky_f4(x);
   case DN_ACT_TANHSHRINK: return dn__tanh_f4(x, 1);
   case DN_ACT_NONE:
   case DN_ACT_SOFTMAX:
   default: return x;
   }
}
static void dn__activate_f4(float *y, size_t y_stride, size_t rows, size_t columns, dn_activation activation)
{
   size_t r, c;
   for (r = 0; r < rows; r++)
      for (c = 0; c < columns; c += 4)
         dn__f4_store(y + r * y_stride + c, dn__act_f4(dn__f4_load(y + r * y_stride + c), activation));
}
/* Without a fused multiply-add every term rounds twice, so DN__RUN terms at a time are added up and then the sums: the
   last layers of the deep networks (504 terms) have little accuracy to spare. */
#define DN__RUN ((size_t)64)
static void dn__tile_f4(const float *x, size_t x_stride, size_t in, const float *w, const float *bias, size_t panels,
                        float *y, size_t y_stride)
{
   dn__f4 w0, w1, w2, w3, v;
   size_t n, first, last;
   (void)panels; /* always 1 */
#define DN__START(r) dn__f4 a##r = w0, b##r = w1, c##r = w2, d##r = w3;
#define DN__STEP(r)                                                                                          \
   v = dn__f4_all(x[r * x_stride + n]);                                                                      \
   a##r = dn__f4_fma(v, w0, a##r);                                                                           \
   b##r = dn__f4_fma(v, w1, b##r);                                                                           \
   c##r = dn__f4_fma(v, w2, c##r);                                                                           \
   d##r = dn__f4_fma(v, w3, d##r);
#define DN__STORE(r)                                                                                         \
   dn__f4_store(y + r * y_stride, first ? dn__f4_add(dn__f4_load(y + r * y_stride), a##r) : a##r);           \
   dn__f4_store(y + r * y_stride + 4, first ? dn__f4_add(dn__f4_load(y + r * y_stride + 4), b##r) : b##r);   \
   dn__f4_store(y + r * y_stride + 8, first ? dn__f4_add(dn__f4_load(y + r * y_stride + 8), c##r) : c##r);   \
   dn__f4_store(y + r * y_stride + 12, first ? dn__f4_add(dn__f4_load(y + r * y_stride + 12), d##r) : d##r);
   for (first = 0; first < in; first = last) {
      last = dn__min(in, first + DN__RUN);
      w0 = first ? dn__f4_all(0.0f) : dn__f4_load(bias);
      w1 = first ? dn__f4_all(0.0f) : dn__f4_load(bias + 4);
      w2 = first ? dn__f4_all(0.0f) : dn__f4_load(bias + 8);
      w3 = first ? dn__f4_all(0.0f) : dn__f4_load(bias + 12);
      DN__F4_EACH(DN__START)
      for (n = first; n < last; n++, w += DN_PANEL) {
         w0 = dn__f4_load(w);
         w1 = dn__f4_load(w + 4);
         w2 = dn__f4_load(w + 8);
         w3 = dn__f4_load(w + 12);
         DN__F4_EACH(DN__STEP)
      }
      DN__F4_EACH(DN__STORE)
   }
#undef DN__START
#undef DN__STEP
#undef DN__STORE
}
static void dn__row_f4(const float *x, size_t in, const float *w, const float *bias, float *y)
{
   size_t n, first, last;
   for (first = 0; first < in; first = last) {
      dn__f4 a = dn__f4_all(0.0f), b = a, c = a, d = a, v;
      last = dn__min(in, first + DN__RUN);
      if (!first) a = dn__f4_load(bias), b = dn__f4_load(bias + 4), c = dn__f4_load(bias + 8), d = dn__f4_load(bias + 12);
      for (n = first; n < last; n++, w += DN_PANEL) {
         v = dn__f4_all(x[n]);
         a = dn__f4_fma(v, dn__f4_load(w), a);
         b = dn__f4_fma(v, dn__f4_load(w + 4), b);
         c = dn__f4_fma(v, dn__f4_load(w + 8), c);
         d = dn__f4_fma(v, dn__f4_load(w + 12), d);
      }
      dn__f4_store(y, first ? dn__f4_add(dn__f4_load(y), a) : a);
      dn__f4_store(y + 4, first ? dn__f4_add(dn__f4_load(y + 4), b) : b);
      dn__f4_store(y + 8, first ? dn__f4_add(dn__f4_load(y + 8), c) : c);
      dn__f4_store(y + 12, first ? dn__f4_add(dn__f4_load(y + 12), d) : d);
   }
}
#endif /* four lanes */

/* --- the choice. The attention texts live in >>attention; the table that joins them is at the end of that part. */
static const dn__kernel *dn__kernel_of(dn_kernel kernel); /* NULL: the reference */

#ifdef DN__HAS_AVX2
static void dn__cpuid(unsigned leaf, unsigned out[4])
{
   #if defined(_MSC_VER) && !defined(__clang__)
   int r[4];
   __cpuidex(r, (int)leaf, 0);
   memcpy(out, r, 16);
   #else
   __cpuid_count(leaf, 0, out[0], out[1], out[2], out[3]);
   #endif
}
static unsigned dn__xgetbv(void) /* which registers the system saves: bits 1, 2 SSE, AVX; 5, 6, 7 AVX-512 */
{
   #if defined(_MSC_VER) && !defined(__clang__)
   return (unsigned)_xgetbv(0);
   #else
   unsigned low, high;
   __asm__ __volatile__(".byte 0x0f, 0x01, 0xd0" : "=a"(low), "=d"(high) : "c"(0)); /* xgetbv */
   (void)high;
   return low;
   #endif
}
static int dn__cpu_has(dn_kernel kernel) /* DN_KERNEL_AVX2 or DN_KERNEL_AVX512 */
{
   const unsigned osxsave = 1u << 27, fma = 1u << 12, avx = 1u << 28, avx2 = 1u << 5;
   const unsigned avx512 = 1u << 16 | 1u << 17 | 1u << 30 | 1u << 31; /* F, DQ, BW, VL */
   unsigned r[4], saved;
   dn__cpuid(0, r);
   if (r[0] < 7) return 0;
   dn__cpuid(1, r);
   if ((r[2] & (osxsave | fma | avx)) != (osxsave | fma | avx)) return 0;
   saved = dn__xgetbv();
   dn__cpuid(7, r);
   if ((saved & 0x06) != 0x06 || !(r[1] & avx2)) return 0;
   return kernel == DN_KERNEL_AVX2 || ((saved & 0xe6) == 0xe6 && (r[1] & avx512) == avx512);
}
#endif
DN_API int dn_kernel_available(dn_kernel kernel)
{
   if (kernel == DN_KERNEL_REF) return 1;
#ifdef DN__HAS_F4
   if (kernel == DN__F4_KERNEL) return 1;
#endif
#ifdef DN__HAS_AVX2
   if (kernel == DN_KERNEL_AVX2) return dn__cpu_has(kernel);
#endif
#ifdef DN__HAS_AVX512
   if (kernel == DN_KERNEL_AVX512) return dn__cpu_has(kernel);
#endif
   return 0;
}
static dn_kernel dn__kernel_best(void) /* the enum lists an architecture's kernels from slow to fast */
{
   int k = DN_KERNEL_COUNT;
   while (--k > 0 && !dn_kernel_available((dn_kernel)k)) {}
   return (dn_kernel)k;
}
DN_API const char *dn_kernel_name(void)
{
   static const char *const names[] = { "reference", "sse", "avx2", "avx512", "neon", "wasm" };
   return names[dn__kernel_best()];
}

/* y = act(x W^T + b), rows begin to end - 1, in tiles. A last tile that would stick out is moved back over rows
   already done, whose bits it repeats; fewer rows than a tile go one by one. A last panel that sticks out past `out`
   goes through a buffer. Rows outside, panels inside: a tile's rows of x stay in the first-level cache while the
   weights stream from the second. */
static void dn__product(const dn_linear *l, const float *x, size_t x_stride, float *y, size_t y_stride, size_t begin,
                        size_t end)
{
   enum { ROWS = 14, COLUMNS = 32 }; /* the largest tile */
   const dn__kernel *k = dn__kernel_of(l->kernel);
   float buffer[ROWS * COLUMNS];
   size_t all = (l->out + DN_PANEL - 1) / DN_PANEL, r, p, rows, panels, i;
   if (!k) {
      dn__product_ref(l, x, x_stride, y, y_stride, begin, end);
      return;
   }
   for (r = begin; r < end; r += rows) {
      rows = end - r >= k->rows ? k->rows : 1;
      if (rows == 1 && end - begin >= k->rows) r = end - k->rows, rows = k->rows;
      for (p = 0; p < all; p += panels) {
         const float *from = x + r * x_stride, *w = l->panels + p * l->in * DN_PANEL, *bias = l->bias + p * DN_PANEL;
         size_t columns, fit;
         float *to = y + r * y_stride + p * DN_PANEL;
         size_t to_stride = y_stride;
         panels = rows == 1 ? 1 : dn__min(k->panels, all - p);
         columns = panels * DN_PANEL;
         fit = dn__min(columns, l->out - p * DN_PANEL);
         if (fit < columns) to = buffer, to_stride = COLUMNS;
         if (rows == 1) k->row(from, l->in, w, bias, to);
         else k->tile(from, x_stride, l->in, w, bias, panels, to, to_stride);
         if (l->activation != DN_ACT_NONE && l->activation != DN_ACT_SOFTMAX)
            k->activate(to, to_stride, rows, columns, l->activation);
         for (i = 0; fit < columns && i < rows; i++)
            memcpy(y + (r + i) * y_stride + p * DN_PANEL, to + i * to_stride, fit * sizeof(float));
      }
      for (i = 0; l->activation == DN_ACT_SOFTMAX && i < rows; i++) dn__softmax(y + (r + i) * y_stride, l->out);
   }
}

/* --- linear layers. Packing folds the batch norm, bn(u) = (u - mean) / sqrt(var + 1e-5) weight + bias, into weight
   and bias; folded in double, stored in float. A variance that is none gives NaN, never a trap. */
static float dn__narrow(double x) /* to float; what does not fit saturates (a conversion would be undefined) */
{
   return x > 3.4028234e38 ? 3.4028234e38f : x < -3.4028234e38 ? -3.4028234e38f : (float)x;
}
/* bn(u) = scale u + shift */
static void dn__fold(const dn_batchnorm *bn, size_t channel, double *scale, double *shift)
{
   *scale = 1;
   *shift = 0;
   if (!bn) return;
   *scale = (double)bn->weight[channel] / DN_SQRT((double)bn->var[channel] + 1e-5);
   *shift = (double)bn->bias[channel] - (double)bn->mean[channel] * *scale;
}
static float *dn__panel_at(float *panels, size_t in, size_t column) /* its weights lie 16 apart from here */
{
   return panels + column / DN_PANEL * in * DN_PANEL + column % DN_PANEL;
}
static void dn__linear_carve(dn__arena *a, size_t in, size_t out, float **panels, float **bias)
{
   size_t columns = dn__round(out, DN_PANEL);
   *panels = (float *)dn__take(a, dn__mul(columns, in), sizeof(float));
   *bias = (float *)dn__take(a, columns, sizeof(float));
}
DN_API size_t dn_linear_size(size_t in, size_t out)
{
   dn__arena a = dn__arena_of(NULL, 0);
   float *panels, *bias;
   dn__linear_carve(&a, in, out, &panels, &bias);
   return in == 0 || out == 0 || dn__gauge(&a) == SIZE_MAX ? 0 : dn__gauge(&a);
}
DN_API void dn_linear_pack(dn_linear *layer, size_t in, size_t out, const float *weight, const float *bias,
                           const dn_batchnorm *bn, dn_activation activation, void *memory)
{
   dn__arena a = dn__arena_of(memory, SIZE_MAX);
   float *panels, *folded;
   size_t o, c;
   DN_ASSERT(dn_linear_size(in, out) != 0 && ((size_t)(uintptr_t)memory & (DN__ALIGN - 1)) == 0);
   dn__linear_carve(&a, in, out, &panels, &folded);
   memset(memory, 0, dn__gauge(&a)); /* columns past `out` stay zero */
   for (o = 0; o < out; o++) {
      double scale, shift;
      float *w = dn__panel_at(panels, in, o);
      dn__fold(bn, o, &scale, &shift);
      for (c = 0; c < in; c++) w[c * DN_PANEL] = dn__narrow(scale * (double)weight[o * in + c]);
      folded[o] = dn__narrow(scale * (bias ? (double)bias[o] : 0.0) + shift);
   }
   layer->in = in;
   layer->out = out;
   layer->activation = activation;
   layer->panels = panels;
   layer->bias = folded;
   layer->kernel = dn__kernel_best();
}
DN_API void dn_linear_ref(const dn_linear *layer, const float *x, size_t x_stride, size_t rows, float *y,
                          size_t y_stride)
{
   dn__product_ref(layer, x, x_stride, y, y_stride, 0, rows);
}
typedef struct dn__linear_job {
   const dn_linear *layer;
   const float *x;
   float *y;
   size_t x_stride, y_stride;
} dn__linear_job;
static void dn__linear_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__linear_job *j = (const dn__linear_job *)job;
   (void)worker;
   dn__product(j->layer, j->x, j->x_stride, j->y, j->y_stride, begin, end);
}
DN_API void dn_linear_run(const dn_linear *layer, const float *x, size_t x_stride, size_t rows, float *y,
                          size_t y_stride, const dn_parallel *parallel)
{
   dn__linear_job job;
   job.layer = layer;
   job.x = x;
   job.y = y;
   job.x_stride = x_stride;
   job.y_stride = y_stride;
   dn__for(parallel, rows, DN__GRAIN, dn__linear_range, &job);
}

/* ===================================================================================== >>attention
   in       rows v (N,d), graph (CSR), one packed block         out  y (N, K*F+B), may be columns of the same wide row
   touches  y and the scratch passed in, (N, K*F + 2K rounded up) floats; nothing else
   paper    T 3.2-3.5, and T 3.6 (dense module) at the end; after Velickovic et al., Graph Attention Networks, ICLR
            2018, sec. 2.1
   read     dn__attend_ref first (the equations), then dn__attend_avx512 (the same, fast)

   Two products: c goes straight to its columns of y; z to a row of scratch for every node, with the logits as further
   columns, since dst_k . (W_k v) = (W_k^T dst_k) . v:

        0            K*F      +K       +2K   stride (a multiple of 16)
        | z, head 0.. | dst.z  | src.z  | 0  |

   Batch norm is folded into the columns of z and c. That is exact: sum_j a_ij (s z_j + t) = s sum_j a_ij z_j + t, as
   the a_ij of a node sum to one. The logit columns are of the plain z. */
static size_t dn__gat_width(size_t heads, size_t features) /* of a row in scratch */
{
   return dn__round(dn__add(dn__mul(heads, features), dn__mul(2, heads)), DN_PANEL);
}
static size_t dn__gat_stride(const dn_gat *b) { return dn__gat_width(b->heads, b->features); }
static void dn__gat_carve(dn__arena *a, size_t in, size_t heads, size_t features, size_t self, float **panels,
                          float **bias, uint32_t **head)
{
   dn__linear_carve(a, in, dn__add(dn__gat_width(heads, features), self), panels, bias);
   *head = (uint32_t *)dn__take(a, dn__round(dn__mul(heads, features), DN_PANEL), sizeof(uint32_t));
}
DN_API size_t dn_gat_size(size_t in, size_t heads, size_t features, size_t self)
{
   dn__arena a = dn__arena_of(NULL, 0);
   float *panels, *bias;
   uint32_t *head;
   dn__gat_carve(&a, in, heads, features, self, &panels, &bias, &head);
   return in == 0 || heads == 0 || features == 0 || dn__gauge(&a) == SIZE_MAX ? 0 : dn__gauge(&a);
}
DN_API void dn_gat_pack(dn_gat *block, size_t in, size_t heads, size_t features, size_t self, const float *lin,
                        const float *att_dst, const float *att_src, const float *self_weight, const dn_batchnorm *bn,
                        dn_activation activation, void *memory)
{
   dn__arena a = dn__arena_of(memory, SIZE_MAX);
   float *panels, *bias, *w;
   uint32_t *head;
   size_t kf = heads * features, width = dn__gat_width(heads, features), o, k, f, c;
   double scale, shift;
   DN_ASSERT(dn_gat_size(in, heads, features, self) != 0 && ((size_t)(uintptr_t)memory & (DN__ALIGN - 1)) == 0);
   DN_ASSERT(self == 0 || self_weight);
   DN_ASSERT(activation != DN_ACT_SOFTMAX);
   dn__gat_carve(&a, in, heads, features, self, &panels, &bias, &head);
   memset(memory, 0, dn__gauge(&a));
   for (o = 0; o < kf + self; o++) {
      const float *from = o < kf ? lin + o * in : self_weight + (o - kf) * in;
      size_t column = o < kf ? o : width + (o - kf);
      dn__fold(bn, o, &scale, &shift);
      w = dn__panel_at(panels, in, column);
      for (c = 0; c < in; c++) w[c * DN_PANEL] = dn__narrow(scale * (double)from[c]);
      bias[column] = dn__narrow(shift);
      if (o < kf) head[o] = (uint32_t)(o / features);
   }
   for (k = 0; k < 2 * heads; k++) { /* W_k^T dst_k, then W_k^T src_k */
      const float *att = k < heads ? att_dst + k * features : att_src + (k - heads) * features;
      const float *from = lin + k % heads * features * in;
      w = dn__panel_at(panels, in, kf + k);
      for (c = 0; c < in; c++) {
         double sum = 0;
         for (f = 0; f < features; f++) sum += (double)att[f] * (double)from[f * in + c];
         w[c * DN_PANEL] = dn__narrow(sum);
      }
   }
   block->in = in;
   block->heads = heads;
   block->features = features;
   block->self = self;
   block->activation = activation;
   block->panels = panels;
   block->bias = bias;
   block->head = head;
   block->kernel = dn__kernel_best();
}
DN_API size_t dn_gat_scratch(const dn_gat *block, size_t nodes)
{
   return dn__round(dn__mul(dn__mul(nodes, dn__gat_stride(block)), sizeof(float)), DN__ALIGN);
}
/* the two products as layers of their own; the first fills whole rows of scratch, padding columns and all */
static dn_linear dn__gat_z(const dn_gat *b)
{
   dn_linear l;
   l.in = b->in;
   l.out = dn__gat_stride(b);
   l.activation = DN_ACT_NONE;
   l.panels = b->panels;
   l.bias = b->bias;
   l.kernel = b->kernel;
   return l;
}
static dn_linear dn__gat_c(const dn_gat *b)
{
   dn_linear l = dn__gat_z(b);
   l.panels += l.in * l.out;
   l.bias += l.out;
   l.out = b->self;
   l.activation = b->activation;
   return l;
}
/* j-th member of node i's neighbourhood: the node itself, then its one-ring */
static size_t dn__member(const dn_graph *g, size_t i, size_t j)
{
   return j == 0 ? i : g->next[g->first[i] + (j - 1)];
}

/* max_j of e_ij = leaky(dst . z_i + src . z_j), so that exp cannot overflow */
static float dn__logit_most(const dn_graph *g, const float *dst, const float *src, size_t stride, size_t i)
{
   size_t j, count = (size_t)(g->first[i + 1] - g->first[i]) + 1;
   float most = dn__leaky(dst[i * stride] + src[i * stride]);
   for (j = 1; j < count; j++) {
      float e = dn__leaky(dst[i * stride] + src[dn__member(g, i, j) * stride]);
      most = e > most ? e : most;
   }
   return most;
}
/* y_i = act( sum_j exp(e_ij - max) z_j / sum_j exp(e_ij - max) ) for each head, nodes begin to end - 1 */
static void dn__attend_ref(const dn_gat *b, const dn_graph *g, const float *z, float *y, size_t y_stride,
                           size_t begin, size_t end)
{
   size_t stride = dn__gat_stride(b), kf = b->heads * b->features, i, j, k, f;
   for (i = begin; i < end; i++) {
      size_t count = (size_t)(g->first[i + 1] - g->first[i]) + 1;
      for (k = 0; k < b->heads; k++) {
         const float *dst = z + kf + k, *src = dst + b->heads; /* columns, rows `stride` apart */
         float *to = y + i * y_stride + k * b->features;       /* (F) */
         float most = dn__logit_most(g, dst, src, stride, i), sum = 0;
         for (f = 0; f < b->features; f++) to[f] = 0;
         for (j = 0; j < count; j++) {
            size_t n = dn__member(g, i, j);
            float a = dn__exp(dn__leaky(dst[i * stride] + src[n * stride]) - most);
            sum += a;
            for (f = 0; f < b->features; f++) to[f] += a * z[n * stride + k * b->features + f];
         }
         for (f = 0; f < b->features; f++) to[f] = dn__activate(to[f] / sum, b->activation);
      }
   }
}

/* The fast texts do the same for all heads at once, a node at a time. Since leaky rises, the largest logit comes from
   the largest source term: max_j leaky(d + s_j) = leaky(d + max_j s_j). exp(e_ij - max) of the whole neighbourhood
   goes to a small buffer (neighbours, pitch heads); then each register's worth of columns is summed over the
   neighbours, the weight of every column drawn from the buffer by its head. A neighbourhood too large for the buffer,
   or more heads than fit, takes the reference path. */
#define DN__WEIGHTS 512 /* floats of buffer: 64 neighbours of 8 heads */
static DN__INLINE float *dn__cache_line(float *p) /* the first 64-byte boundary from p on, at most 15 floats away */
{
   return p + ((16 - ((size_t)(uintptr_t)p >> 2 & 15)) & 15);
}

#ifdef DN__HAS_AVX2
/* e_ij - max for up to 8 heads; e (count,8), idle heads 0 */
DN__TARGET_AVX2 static DN__INLINE void dn__logits_avx2(const dn_gat *b, const dn_graph *g, const float *z,
                                                       size_t stride, size_t i, size_t count, __m256i heads,
                                                       float *e)
{
   size_t at = b->heads * b->features, j;
   const float *src = z + at + b->heads;
   const uint32_t *next = g->next + g->first[i];
   __m256 d = _mm256_maskload_ps(z + i * stride + at, heads);
   __m256 own = _mm256_maskload_ps(src + i * stride, heads), most = own;
   for (j = 0; j + 1 < count; j++) {
      __m256 s = _mm256_maskload_ps(src + next[j] * stride, heads);
      most = _mm256_max_ps(most, s);
      _mm256_storeu_ps(e + (j + 1) * 8, dn__leaky_avx2(_mm256_add_ps(d, s)));
   }
   most = dn__leaky_avx2(_mm256_add_ps(d, most));
   _mm256_storeu_ps(e, _mm256_sub_ps(dn__leaky_avx2(_mm256_add_ps(d, own)), most));
   for (j = 1; j < count; j++) _mm256_storeu_ps(e + j * 8, _mm256_sub_ps(_mm256_loadu_ps(e + j * 8), most));
}
/* Asks for the rows that node i will read and that no earlier node has: its neighbours of higher index. Four nodes
   ahead this halves the time when z has left the second-level cache (10,220 nodes of 8 x 8: 71 to 57 ns a node) and
   costs 2 ns when it has not; asking for all neighbours costs 10. */
#define DN__AHEAD 4
DN__TARGET_AVX2 static DN__INLINE void dn__prefetch_avx2(const dn_graph *g, const float *z, size_t stride, size_t i)
{
   size_t e, c;
   for (e = g->first[i]; e < g->first[i + 1]; e++)
      for (c = 0; g->next[e] > i && c < stride; c += 16)
         _mm_prefetch((const char *)(z + g->next[e] * stride + c), _MM_HINT_T0);
}
DN__TARGET_AVX2 static DN__INLINE __m256i dn__lanes_avx2(size_t count) /* the first `count` of 8 */
{
   const __m256i lane = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
   return _mm256_cmpgt_epi32(_mm256_set1_epi32(count < 8 ? (int)count : 8), lane);
}
DN__TARGET_AVX2 static void dn__attend_avx2(const dn_gat *b, const dn_graph *g, const float *z, float *y,
                                            size_t y_stride, size_t begin, size_t end)
{
   size_t stride = dn__gat_stride(b), kf = b->heads * b->features, i, j, c;
   const __m256i heads = dn__lanes_avx2(b->heads);
   float room[DN__WEIGHTS + 15], *e = dn__cache_line(room); /* (count,8) */
   for (i = begin; i < end; i++) {
      size_t count = (size_t)(g->first[i + 1] - g->first[i]) + 1;
      const uint32_t *next = g->next + g->first[i];
      const float *own = z + i * stride;
      float *to = y + i * y_stride;
      __m256 sum = _mm256_setzero_ps(), part;
      if (i + DN__AHEAD < end) dn__prefetch_avx2(g, z, stride, i + DN__AHEAD);
      if (b->heads > 8 || count > DN__WEIGHTS / 8) {
         dn__attend_ref(b, g, z, y, y_stride, i, i + 1);
         continue;
      }
      dn__logits_avx2(b, g, z, stride, i, count, heads, e);
      for (j = 0; j < count; j++) {
         __m256 a = dn__exp_avx2(_mm256_loadu_ps(e + j * 8));
         _mm256_storeu_ps(e + j * 8, a);
         sum = _mm256_add_ps(sum, a);
      }
      part = _mm256_div_ps(_mm256_set1_ps(1.0f), sum);
      for (c = 0; c + 32 <= kf; c += 32) { /* four registers of columns: sum_j a_ij z_j */
         __m256i h0 = _mm256_loadu_si256((const __m256i *)(const void *)(b->head + c));
         __m256i h1 = _mm256_loadu_si256((const __m256i *)(const void *)(b->head + c + 8));
         __m256i h2 = _mm256_loadu_si256((const __m256i *)(const void *)(b->head + c + 16));
         __m256i h3 = _mm256_loadu_si256((const __m256i *)(const void *)(b->head + c + 24));
         __m256 a = _mm256_loadu_ps(e);
         __m256 s0 = _mm256_mul_ps(_mm256_permutevar8x32_ps(a, h0), _mm256_loadu_ps(own + c));
         __m256 s1 = _mm256_mul_ps(_mm256_permutevar8x32_ps(a, h1), _mm256_loadu_ps(own + c + 8));
         __m256 s2 = _mm256_mul_ps(_mm256_permutevar8x32_ps(a, h2), _mm256_loadu_ps(own + c + 16));
         __m256 s3 = _mm256_mul_ps(_mm256_permutevar8x32_ps(a, h3), _mm256_loadu_ps(own + c + 24));
         for (j = 1; j < count; j++) {
            const float *row = z + next[j - 1] * stride + c;
            a = _mm256_loadu_ps(e + j * 8);
            s0 = _mm256_fmadd_ps(_mm256_permutevar8x32_ps(a, h0), _mm256_loadu_ps(row), s0);
            s1 = _mm256_fmadd_ps(_mm256_permutevar8x32_ps(a, h1), _mm256_loadu_ps(row + 8), s1);
            s2 = _mm256_fmadd_ps(_mm256_permutevar8x32_ps(a, h2), _mm256_loadu_ps(row + 16), s2);
            s3 = _mm256_fmadd_ps(_mm256_permutevar8x32_ps(a, h3), _mm256_loadu_ps(row + 24), s3);
         }
         s0 = _mm256_mul_ps(s0, _mm256_permutevar8x32_ps(part, h0));
         s1 = _mm256_mul_ps(s1, _mm256_permutevar8x32_ps(part, h1));
         s2 = _mm256_mul_ps(s2, _mm256_permutevar8x32_ps(part, h2));
         s3 = _mm256_mul_ps(s3, _mm256_permutevar8x32_ps(part, h3));
         _mm256_storeu_ps(to + c, dn__act_avx2(s0, b->activation));
         _mm256_storeu_ps(to + c + 8, dn__act_avx2(s1, b->activation));
         _mm256_storeu_ps(to + c + 16, dn__act_avx2(s2, b->activation));
         _mm256_storeu_ps(to + c + 24, dn__act_avx2(s3, b->activation));
      }
      for (; c < kf; c += 8) { /* and one; a row has room for whole registers, y has not */
         __m256i h = _mm256_loadu_si256((const __m256i *)(const void *)(b->head + c));
         __m256 s = _mm256_mul_ps(_mm256_permutevar8x32_ps(_mm256_loadu_ps(e), h), _mm256_loadu_ps(own + c));
         for (j = 1; j < count; j++)
            s = _mm256_fmadd_ps(_mm256_permutevar8x32_ps(_mm256_loadu_ps(e + j * 8), h),
                                _mm256_loadu_ps(z + next[j - 1] * stride + c), s);
         s = _mm256_mul_ps(s, _mm256_permutevar8x32_ps(part, h));
         _mm256_maskstore_ps(to + c, dn__lanes_avx2(kf - c), dn__act_avx2(s, b->activation));
      }
   }
}
static const dn__kernel dn__kernel_avx2 = { 6, 1, dn__tile_avx2, dn__row_avx2, dn__activate_avx2, dn__attend_avx2 };
#endif

#ifdef DN__HAS_AVX512
#define DN__WIDE(p) _mm512_castps256_ps512(_mm256_loadu_ps(p)) /* eight weights; the upper lanes are not drawn from */
DN__TARGET_AVX512 static DN__INLINE __mmask16 dn__lanes_avx512(size_t count) /* the first `count` of 16 */
{
   return (__mmask16)(count < 16 ? (1u << count) - 1u : 0xffffu);
}
DN__TARGET_AVX512 static void dn__attend_avx512(const dn_gat *b, const dn_graph *g, const float *z, float *y,
                                                size_t y_stride, size_t begin, size_t end)
{
   size_t stride = dn__gat_stride(b), kf = b->heads * b->features, i, j, c;
   const __m256i heads = dn__lanes_avx2(b->heads);
   float room[DN__WEIGHTS + 8 + 15], *e = dn__cache_line(room); /* (count,8) and one more */
   for (i = begin; i < end; i++) {
      size_t count = (size_t)(g->first[i + 1] - g->first[i]) + 1;
      const uint32_t *next = g->next + g->first[i];
      const float *own = z + i * stride;
      float *to = y + i * y_stride;
      __m256 sum = _mm256_setzero_ps();
      __m512 part;
      if (i + DN__AHEAD < end) dn__prefetch_avx2(g, z, stride, i + DN__AHEAD);
      if (b->heads > 8 || count > DN__WEIGHTS / 8) {
         dn__attend_ref(b, g, z, y, y_stride, i, i + 1);
         continue;
      }
      dn__logits_avx2(b, g, z, stride, i, count, heads, e);
      _mm256_storeu_ps(e + count * 8, sum); /* so that the last 16 are numbers */
      for (j = 0; j < count; j += 2) { /* two neighbours; no load here spans two stores, that would stall */
         __m512 a = _mm512_insertf32x8(DN__WIDE(e + j * 8), _mm256_loadu_ps(e + j * 8 + 8), 1);
         _mm512_storeu_ps(e + j * 8, dn__exp_avx512(a));
      }
      for (j = 0; j < count; j++) sum = _mm256_add_ps(sum, _mm256_loadu_ps(e + j * 8));
      part = _mm512_castps256_ps512(_mm256_div_ps(_mm256_set1_ps(1.0f), sum));
      for (c = 0; c + 64 <= kf; c += 64) { /* four registers of columns: sum_j a_ij z_j */
         __m512i h0 = _mm512_loadu_si512(b->head + c), h1 = _mm512_loadu_si512(b->head + c + 16);
         __m512i h2 = _mm512_loadu_si512(b->head + c + 32), h3 = _mm512_loadu_si512(b->head + c + 48);
         __m512 a = DN__WIDE(e);
         __m512 s0 = _mm512_mul_ps(_mm512_maskz_permutexvar_ps(DN__ALL, h0, a), _mm512_loadu_ps(own + c));
         __m512 s1 = _mm512_mul_ps(_mm512_maskz_permutexvar_ps(DN__ALL, h1, a), _mm512_loadu_ps(own + c + 16));
         __m512 s2 = _mm512_mul_ps(_mm512_maskz_permutexvar_ps(DN__ALL, h2, a), _mm512_loadu_ps(own + c + 32));
         __m512 s3 = _mm512_mul_ps(_mm512_maskz_permutexvar_ps(DN__ALL, h3, a), _mm512_loadu_ps(own + c + 48));
         for (j = 1; j < count; j++) {
            const float *row = z + next[j - 1] * stride + c;
            a = DN__WIDE(e + j * 8);
            s0 = _mm512_fmadd_ps(_mm512_maskz_permutexvar_ps(DN__ALL, h0, a), _mm512_loadu_ps(row), s0);
            s1 = _mm512_fmadd_ps(_mm512_maskz_permutexvar_ps(DN__ALL, h1, a), _mm512_loadu_ps(row + 16), s1);
            s2 = _mm512_fmadd_ps(_mm512_maskz_permutexvar_ps(DN__ALL, h2, a), _mm512_loadu_ps(row + 32), s2);
            s3 = _mm512_fmadd_ps(_mm512_maskz_permutexvar_ps(DN__ALL, h3, a), _mm512_loadu_ps(row + 48), s3);
         }
         s0 = _mm512_mul_ps(s0, _mm512_maskz_permutexvar_ps(DN__ALL, h0, part));
         s1 = _mm512_mul_ps(s1, _mm512_maskz_permutexvar_ps(DN__ALL, h1, part));
         s2 = _mm512_mul_ps(s2, _mm512_maskz_permutexvar_ps(DN__ALL, h2, part));
         s3 = _mm512_mul_ps(s3, _mm512_maskz_permutexvar_ps(DN__ALL, h3, part));
         _mm512_storeu_ps(to + c, dn__act_avx512(s0, b->activation));
         _mm512_storeu_ps(to + c + 16, dn__act_avx512(s1, b->activation));
         _mm512_storeu_ps(to + c + 32, dn__act_avx512(s2, b->activation));
         _mm512_storeu_ps(to + c + 48, dn__act_avx512(s3, b->activation));
      }
      for (; c < kf; c += 16) { /* and one; a row has room for whole registers, y has not */
         __m512i h = _mm512_loadu_si512(b->head + c);
         __m512 s = _mm512_mul_ps(_mm512_maskz_permutexvar_ps(DN__ALL, h, DN__WIDE(e)), _mm512_loadu_ps(own + c));
         for (j = 1; j < count; j++)
            s = _mm512_fmadd_ps(_mm512_maskz_permutexvar_ps(DN__ALL, h, DN__WIDE(e + j * 8)),
                                _mm512_loadu_ps(z + next[j - 1] * stride + c), s);
         s = _mm512_mul_ps(s, _mm512_maskz_permutexvar_ps(DN__ALL, h, part));
         _mm512_mask_storeu_ps(to + c, dn__lanes_avx512(kf - c), dn__act_avx512(s, b->activation));
      }
   }
}
#undef DN__WIDE
static const dn__kernel dn__kernel_avx512 = { 14, 2, dn__tile_avx512, dn__row_avx512, dn__activate_avx512,
                                              dn__attend_avx512 };
#endif

#ifdef DN__HAS_F4
static DN__INLINE dn__f4 dn__draw_f4(const float *e, const uint32_t *head, int one) /* the weights of four columns */
{
   float a[4];
   if (one) return dn__f4_all(e[head[0]]); /* F a multiple of 4: one head for all */
   a[0] = e[head[0]], a[1] = e[head[1]], a[2] = e[head[2]], a[3] = e[head[3]];
   return dn__f4_load(a);
}
static DN__INLINE void dn__store_f4(float *to, size_t count, dn__f4 a) /* the first `count` of 4 */
{
   float part[4];
   if (count >= 4) {
      dn__f4_store(to, a);
   } else {
      dn__f4_store(part, a);
      memcpy(to, part, count * sizeof(float));
   }
}
static void dn__attend_f4(const dn_gat *b, const dn_graph *g, const float *z, float *y, size_t y_stride, size_t begin,
                          size_t end)
{
   size_t stride = dn__gat_stride(b), kf = b->heads * b->features, i, j, k, c;
   int one = b->features % 4 == 0;
   float e[DN__WEIGHTS]; /* (count,heads) and 1 / sum (heads); heads rounded up to whole registers */
   size_t pitch = dn__round(b->heads, 4), most_count = DN__WEIGHTS / pitch;
   for (i = begin; i < end; i++) {
      size_t count = (size_t)(g->first[i + 1] - g->first[i]) + 1;
      const uint32_t *next = g->next + g->first[i];
      const float *own = z + i * stride, *dst = own + kf; /* (K) dst . z_i, then (K) src . z_i */
      float *to = y + i * y_stride, *part;
      if (count >= most_count) {
         dn__attend_ref(b, g, z, y, y_stride, i, i + 1);
         continue;
      }
      part = e + count * pitch;
      memset(e, 0, (count + 1) * pitch * sizeof(float));
      for (j = 0; j < count; j++) {
         const float *src = z + (j ? next[j - 1] : i) * stride + kf + b->heads;
         for (k = 0; k < b->heads; k++) e[j * pitch + k] = dn__leaky(dst[k] + src[k]);
      }
      for (k = 0; k < pitch; k += 4) { /* four heads at once */
         dn__f4 most = dn__f4_load(e + k), sum = dn__f4_all(0.0f);
         for (j = 1; j < count; j++) most = dn__f4_max(most, dn__f4_load(e + j * pitch + k));
         for (j = 0; j < count; j++) {
            dn__f4 a = dn__exp_f4(dn__f4_sub(dn__f4_load(e + j * pitch + k), most));
            dn__f4_store(e + j * pitch + k, a);
            sum = dn__f4_add(sum, a);
         }
         dn__f4_store(part + k, dn__f4_div(dn__f4_all(1.0f), sum));
      }
      for (c = 0; c < kf; c += 4) { /* sum_j a_ij z_j; a row has room for whole registers, y has not */
         dn__f4 s = dn__f4_mul(dn__draw_f4(e, b->head + c, one), dn__f4_load(own + c));
         for (j = 1; j < count; j++)
            s = dn__f4_fma(dn__draw_f4(e + j * pitch, b->head + c, one),
                           dn__f4_load(z + next[j - 1] * stride + c), s);
         s = dn__f4_mul(s, dn__draw_f4(part, b->head + c, one));
         dn__store_f4(to + c, kf - c, dn__act_f4(s, b->activation));
      }
   }
}
static const dn__kernel dn__kernel_f4 = { DN__F4_ROWS, 1, dn__tile_f4, dn__row_f4, dn__activate_f4, dn__attend_f4 };
#endif

static const dn__kernel *dn__kernel_of(dn_kernel kernel)
{
#ifdef DN__HAS_F4
   if (kernel == DN__F4_KERNEL) return &dn__kernel_f4;
#endif
#ifdef DN__HAS_AVX2
   if (kernel == DN_KERNEL_AVX2) return &dn__kernel_avx2;
#endif
#ifdef DN__HAS_AVX512
   if (kernel == DN_KERNEL_AVX512) return &dn__kernel_avx512;
#endif
   (void)kernel;
   return NULL;
}
DN_API void dn_gat_ref(const dn_gat *block, const dn_graph *g, const float *v, size_t v_stride, float *y,
                       size_t y_stride, void *scratch)
{
   dn_linear z_of = dn__gat_z(block), c_of = dn__gat_c(block);
   float *z = (float *)scratch; /* (N,stride) */
   dn__product_ref(&z_of, v, v_stride, z, z_of.out, 0, g->nodes);
   dn__product_ref(&c_of, v, v_stride, y + block->heads * block->features, y_stride, 0, g->nodes);
   dn__attend_ref(block, g, z, y, y_stride, 0, g->nodes);
}
typedef struct dn__gat_job {
   const dn_gat *block;
   const dn_graph *g;
   const float *v;
   float *z, *y;
   size_t v_stride, y_stride;
} dn__gat_job;
static void dn__gat_products(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__gat_job *j = (const dn__gat_job *)job;
   dn_linear z_of = dn__gat_z(j->block), c_of = dn__gat_c(j->block);
   (void)worker;
   dn__product(&z_of, j->v, j->v_stride, j->z, z_of.out, begin, end);
   dn__product(&c_of, j->v, j->v_stride, j->y + j->block->heads * j->block->features, j->y_stride, begin, end);
}
static void dn__gat_attend(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__gat_job *j = (const dn__gat_job *)job;
   const dn__kernel *k = dn__kernel_of(j->block->kernel);
   (void)worker;
   (k ? k->attend : dn__attend_ref)(j->block, j->g, j->z, j->y, j->y_stride, begin, end);
}
DN_API void dn_gat_run(const dn_gat *block, const dn_graph *g, const float *v, size_t v_stride, float *y,
                       size_t y_stride, void *scratch, const dn_parallel *parallel)
{
   dn__gat_job job;
   job.block = block;
   job.g = g;
   job.v = v;
   job.z = (float *)scratch;
   job.y = y;
   job.v_stride = v_stride;
   job.y_stride = y_stride;
   dn__for(parallel, g->nodes, DN__GRAIN, dn__gat_products, &job);
   dn__for(parallel, g->nodes, DN__GRAIN, dn__gat_attend, &job); /* reads z of neighbours: all must be there */
}
DN_API void dn_gat_attention(const dn_gat *block, const dn_graph *g, const float *v, size_t v_stride, float *alpha,
                             void *scratch)
{
   dn_linear z_of = dn__gat_z(block);
   float *z = (float *)scratch;
   size_t stride = z_of.out, i, j, k;
   dn__product(&z_of, v, v_stride, z, stride, 0, g->nodes);
   for (i = 0; i < g->nodes; i++) {
      size_t count = (size_t)(g->first[i + 1] - g->first[i]) + 1;
      float *rows = alpha + (g->first[i] + i) * block->heads; /* (count,K) */
      for (k = 0; k < block->heads; k++) {
         const float *dst = z + block->heads * block->features + k, *src = dst + block->heads;
         float most = dn__logit_most(g, dst, src, stride, i), sum = 0;
         for (j = 0; j < count; j++)
            sum += rows[j * block->heads + k] =
               dn__exp(dn__leaky(dst[i * stride] + src[dn__member(g, i, j) * stride]) - most);
         for (j = 0; j < count; j++) rows[j * block->heads + k] /= sum;
      }
   }
}

/* T 3.6:  x_{b+1} = f_b(x_b) || x_b, newest first, so the wide row fills from the right:

        | f_2(x_2) | f_1(x_1) | f_0(x_0) | x_0 |
                              ^ x_1 starts here                */
DN_API void dn_dense_run(const dn_gat *blocks, size_t count, const dn_graph *g, float *rows, size_t row_stride,
                         size_t width, void *scratch, const dn_parallel *parallel)
{
   size_t b, at = count ? width - blocks[0].in : 0;
   for (b = 0; b < count; b++) {
      size_t made = blocks[b].heads * blocks[b].features + blocks[b].self;
      DN_ASSERT(blocks[b].in == width - at && made <= at);
      dn_gat_run(&blocks[b], g, rows + at, row_stride, rows + at - made, row_stride, scratch, parallel);
      at -= made;
   }
}

/* ===================================================================================== >>pooling
   in       rows v (N,d), graph (CSR)      out  clusters: pairs, scores, the coarse graph
   touches  the clusters' arrays and the scratch passed in
   paper    T 3.10-3.12; after Diehl, Edge Contraction Pooling for Graph Neural Networks, 2019
   read     dn_pool_contract_ref first; dn_pool_contract does the same in linear time */
DN_API size_t dn_pool_size(size_t in, size_t features)
{
   size_t bytes = dn__mul(2, dn__round(dn__mul(in, sizeof(float)), DN__ALIGN));
   return in == 0 || features == 0 || bytes == SIZE_MAX ? 0 : bytes;
}
DN_API void dn_pool_pack(dn_pool *pool, size_t in, size_t features, const float *lin, const float *att_dst,
                         const float *att_src, float offset, void *memory)
{
   dn__arena a = dn__arena_of(memory, SIZE_MAX);
   float *dst = (float *)dn__take(&a, in, sizeof(float)), *src = (float *)dn__take(&a, in, sizeof(float));
   size_t c, f;
   for (c = 0; c < in; c++) { /* W^T att */
      double d = 0, s = 0;
      for (f = 0; f < features; f++) {
         d += (double)att_dst[f] * (double)lin[f * in + c];
         s += (double)att_src[f] * (double)lin[f * in + c];
      }
      dst[c] = dn__narrow(d);
      src[c] = dn__narrow(s);
   }
   pool->in = in;
   pool->dst = dst;
   pool->src = src;
   pool->offset = offset;
}
static float dn__dot(const float *a, const float *b, size_t count) /* eight partial sums: compilers vectorise this */
{
   float s[8] = { 0, 0, 0, 0, 0, 0, 0, 0 };
   size_t i, l;
   for (i = 0; i + 8 <= count; i += 8)
      for (l = 0; l < 8; l++) s[l] += a[i + l] * b[i + l];
   for (; i < count; i++) s[0] += a[i] * b[i];
   return ((s[0] + s[4]) + (s[1] + s[5])) + ((s[2] + s[6]) + (s[3] + s[7]));
}
typedef struct dn__pool_work { /* one scratch for scoring and for contracting */
   float *logit;               /* (2,N) dst . v, then src . v */
   uint64_t *order, *spare;    /* (2E) key << 32 | edge, being sorted */
   uint32_t *from;             /* (2E) node i of directed edge (i,j) */
   uint32_t *mark;             /* (N) */
} dn__pool_work;
static dn__pool_work dn__pool_carve(dn__arena *a, size_t nodes, size_t edges)
{
   dn__pool_work w;
   w.logit = (float *)dn__take(a, dn__mul(2, nodes), sizeof(float));
   w.order = (uint64_t *)dn__take(a, edges, sizeof(uint64_t));
   w.spare = (uint64_t *)dn__take(a, edges, sizeof(uint64_t));
   w.from = (uint32_t *)dn__take(a, edges, sizeof(uint32_t));
   w.mark = (uint32_t *)dn__take(a, nodes, sizeof(uint32_t));
   return w;
}
DN_API size_t dn_pool_scratch(size_t nodes, size_t neighbours)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn__pool_carve(&a, nodes, neighbours);
   return dn__gauge(&a);
}

typedef struct dn__pool_job {
   const dn_pool *pool;
   const dn_graph *g;
   const dn_clusters *c;
   const float *v; /* rows read */
   float *y;       /* rows written */
   size_t v_stride, y_stride, width;
   float *logit, *scores;
} dn__pool_job;
static dn__pool_job dn__pool_job_of(const dn_pool *pool, const dn_graph *g, const dn_clusters *c)
{
   dn__pool_job j;
   memset(&j, 0, sizeof j);
   j.pool = pool;
   j.g = g;
   j.c = c;
   return j;
}
static void dn__pool_logits(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__pool_job *j = (const dn__pool_job *)job;
   size_t i;
   (void)worker;
   for (i = begin; i < end; i++) {
      const float *row = j->v + i * j->v_stride; /* (in) */
      j->logit[i] = dn__dot(j->pool->dst, row, j->pool->in);
      j->logit[j->g->nodes + i] = dn__dot(j->pool->src, row, j->pool->in);
   }
}
/* alpha_ij = softmax over j in N(i), i itself left out, of leaky(dst . z_i + src . z_j) */
static void dn__pool_softmax(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__pool_job *j = (const dn__pool_job *)job;
   size_t i;
   (void)worker;
   for (i = begin; i < end; i++) {
      size_t from = j->g->first[i], to = j->g->first[i + 1], e;
      for (e = from; e < to; e++) j->scores[e] = dn__leaky(j->logit[i] + j->logit[j->g->nodes + j->g->next[e]]);
      if (from < to) dn__softmax(j->scores + from, to - from);
   }
}
DN_API void dn_pool_scores(const dn_pool *pool, const dn_graph *g, const float *v, size_t v_stride, float *scores,
                           void *scratch, const dn_parallel *parallel)
{
   dn__arena a = dn__arena_of(scratch, SIZE_MAX);
   dn__pool_job job = dn__pool_job_of(pool, g, NULL);
   job.v = v;
   job.v_stride = v_stride;
   job.logit = dn__pool_carve(&a, g->nodes, g->first[g->nodes]).logit;
   job.scores = scores;
   dn__for(parallel, g->nodes, DN__GRAIN, dn__pool_logits, &job);
   dn__for(parallel, g->nodes, DN__GRAIN, dn__pool_softmax, &job);
}

/* Numbers the clusters by their smaller member. pick[i]: the directed edge that took i, or UINT32_MAX */
static void dn__clusters_number(const dn_graph *g, const float *scores, const uint32_t *from, const uint32_t *pick,
                                dn_clusters *c)
{
   size_t i;
   c->count = 0;
   for (i = 0; i < g->nodes; i++) {
      uint32_t e = pick[i], m = (uint32_t)c->count;
      uint32_t a = e == UINT32_MAX ? (uint32_t)i : from[e], b = e == UINT32_MAX ? (uint32_t)i : g->next[e];
      if (a < i || b < i) continue; /* numbered when the other end was met */
      c->members[2 * c->count] = a;
      c->members[2 * c->count + 1] = b;
      c->score[c->count++] = e == UINT32_MAX ? 1.0f : scores[e];
      c->cluster[a] = c->cluster[b] = m;
   }
}
static void dn__expand_from(const dn_graph *g, uint32_t *from)
{
   size_t i, e;
   for (i = 0; i < g->nodes; i++)
      for (e = g->first[i]; e < g->first[i + 1]; e++) from[e] = (uint32_t)i;
}

/* Does edge a come before edge b in the list? Higher score first, NaN after every number; ties by (i,j), which is the
   order of the entries. */
static int dn__edge_before(const float *scores, size_t a, size_t b)
{
   int na = dn__nan(scores[a]), nb = dn__nan(scores[b]);
   if (na != nb) return nb;
   if (!na && scores[a] < scores[b]) return 0;
   if (!na && scores[a] > scores[b]) return 1;
   return a < b;
}
DN_API void dn_pool_contract_ref(const dn_graph *g, const float *scores, dn_clusters *clusters, void *scratch)
{
   dn__arena a = dn__arena_of(scratch, SIZE_MAX);
   size_t edges = g->first[g->nodes];
   dn__pool_work w = dn__pool_carve(&a, g->nodes, edges);
   size_t e, k, m, n, at = 0;
   dn__expand_from(g, w.from);
   for (e = 0; e < edges; e++) { /* insertion sort of the directed edges */
      for (k = e; k > 0 && dn__edge_before(scores, e, (size_t)w.order[k - 1]); k--) w.order[k] = w.order[k - 1];
      w.order[k] = e;
   }
   memset(w.mark, 0xff, g->nodes * sizeof(uint32_t));
   for (k = 0; k < edges; k++) { /* contract when neither end is taken */
      uint32_t i, j;
      e = (size_t)w.order[k];
      i = w.from[e];
      j = g->next[e];
      if (w.mark[i] == UINT32_MAX && w.mark[j] == UINT32_MAX) w.mark[i] = w.mark[j] = (uint32_t)e;
   }
   dn__clusters_number(g, scores, w.from, w.mark, clusters);
   for (m = 0; m < clusters->count; m++) { /* (m,n) is a coarse edge when any fine edge joins their members */
      clusters->coarse_first[m] = (uint32_t)at;
      for (n = 0; n < clusters->count; n++) {
         int joined = 0;
         for (k = 0; k < 2 && m != n; k++) {
            uint32_t i = clusters->members[2 * m + k];
            for (e = g->first[i]; e < g->first[i + 1]; e++) joined |= clusters->cluster[g->next[e]] == n;
         }
         if (joined) clusters->coarse_next[at++] = (uint32_t)n;
      }
   }
   clusters->coarse_first[clusters->count] = (uint32_t)at;
   clusters->graph.nodes = clusters->count;
   clusters->graph.first = clusters->coarse_first;
   clusters->graph.next = clusters->coarse_next;
}

/* Falling scores as rising integers: a float's bits, read as sign and magnitude, rise with its value. Both zeros get
   one key, all NaN the last. */
static uint32_t dn__falling_key(float score)
{
   uint32_t u;
   if (dn__nan(score)) return UINT32_MAX;
   score += 0.0f; /* -0 to +0 */
   memcpy(&u, &score, 4);
   return u & 0x80000000u ? u : ~(u | 0x80000000u);
}
/* the directed edges by key, ties in order of the entries: least significant digit first, three digits of 11 bits */
static uint64_t *dn__sort_edges(uint64_t *order, uint64_t *spare, size_t edges)
{
   enum { BITS = 11, DIGITS = 1 << BITS };
   unsigned shift;
   for (shift = 32; shift < 64; shift += BITS) {
      uint32_t at[DIGITS], sum = 0;
      uint64_t *swap = order;
      size_t e, d;
      memset(at, 0, sizeof at);
      for (e = 0; e < edges; e++) at[(order[e] >> shift) & (DIGITS - 1)]++;
      for (d = 0; d < DIGITS; d++) {
         uint32_t count = at[d];
         at[d] = sum;
         sum += count;
      }
      for (e = 0; e < edges; e++) spare[at[(order[e] >> shift) & (DIGITS - 1)]++] = order[e];
      order = spare;
      spare = swap;
   }
   return order;
}
/* visits each coarse edge (m,n) once, as m's members' neighbours show it; pass 1 counts the edges into n, pass 2
   writes m into n's list, which so comes out ascending. mark[n] remembers the last m that met n. */
static void dn__coarse_edges(const dn_graph *g, const dn_clusters *c, uint32_t *mark, uint32_t *at, int write)
{
   size_t m, e, k;
   memset(mark, 0xff, c->count * sizeof(uint32_t));
   for (m = 0; m < c->count; m++) {
      uint32_t a = c->members[2 * m], b = c->members[2 * m + 1];
      mark[m] = (uint32_t)m; /* no edge to itself */
      for (k = 0; k < (a == b ? 1u : 2u); k++) {
         uint32_t i = k ? b : a;
         for (e = g->first[i]; e < g->first[i + 1]; e++) {
            uint32_t n = c->cluster[g->next[e]];
            if (mark[n] == (uint32_t)m) continue;
            mark[n] = (uint32_t)m;
            if (write) c->coarse_next[at[n]++] = (uint32_t)m;
            else at[n]++;
         }
      }
   }
}
DN_API void dn_pool_contract(const dn_graph *g, const float *scores, dn_clusters *clusters, void *scratch)
{
   dn__arena a = dn__arena_of(scratch, SIZE_MAX);
   size_t edges = g->first[g->nodes];
   dn__pool_work w = dn__pool_carve(&a, g->nodes, edges);
   size_t e, m;
   uint32_t *pick = w.mark, *first = clusters->coarse_first, *at = (uint32_t *)(void *)w.logit, sum = 0;
   const uint64_t *order;
   dn__expand_from(g, w.from);
   for (e = 0; e < edges; e++) w.order[e] = (uint64_t)dn__falling_key(scores[e]) << 32 | e;
   order = dn__sort_edges(w.order, w.spare, edges);
   memset(pick, 0xff, g->nodes * sizeof(uint32_t));
   for (e = 0; e < edges; e++) { /* contract when neither end is taken */
      uint32_t id = (uint32_t)order[e], i = w.from[id], j = g->next[id];
      if (pick[i] == UINT32_MAX && pick[j] == UINT32_MAX) pick[i] = pick[j] = id;
   }
   dn__clusters_number(g, scores, w.from, pick, clusters);

   memset(at, 0, clusters->count * sizeof(uint32_t));
   dn__coarse_edges(g, clusters, w.mark, at, 0);
   for (m = 0; m < clusters->count; m++) {
      uint32_t count = at[m];
      first[m] = at[m] = sum;
      sum += count;
   }
   first[clusters->count] = sum;
   dn__coarse_edges(g, clusters, w.mark, at, 1);
   clusters->graph.nodes = clusters->count;
   clusters->graph.first = clusters->coarse_first;
   clusters->graph.next = clusters->coarse_next;
}

static void dn__pool_rescore_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__pool_job *p = (const dn__pool_job *)job;
   size_t m, e;
   (void)worker;
   for (m = begin; m < end; m++) {
      size_t i = p->c->members[2 * m], j = p->c->members[2 * m + 1];
      float dst, own = 0, most = 0, sum = 0;
      if (i == j) continue;
      dst = dn__dot(p->pool->dst, p->v + i * p->v_stride, p->pool->in);
      for (e = p->g->first[i]; e < p->g->first[i + 1]; e++) {
         /* softmax in one pass: what was summed under a smaller maximum is scaled down */
         float x = dn__leaky(dst + dn__dot(p->pool->src, p->v + p->g->next[e] * p->v_stride, p->pool->in));
         if (e == p->g->first[i] || x > most) {
            sum = e == p->g->first[i] ? 0 : sum * dn__exp(most - x);
            most = x;
         }
         sum += dn__exp(x - most);
         if (p->g->next[e] == j) own = x;
      }
      p->scores[m] = dn__exp(own - most) / sum;
   }
}
DN_API void dn_pool_rescore(const dn_pool *pool, const dn_graph *g, const float *v, size_t v_stride,
                            dn_clusters *clusters, const dn_parallel *parallel)
{
   dn__pool_job job = dn__pool_job_of(pool, g, clusters);
   job.v = v;
   job.v_stride = v_stride;
   job.scores = clusters->score;
   dn__for(parallel, clusters->count, DN__GRAIN, dn__pool_rescore_range, &job);
}

/* the factor of a pair in both formulas: its score plus the layer's offset, never under 1e-6 */
static float dn__pool_factor(const dn_pool *pool, const dn_clusters *c, size_t m)
{
   float s = c->score[m] + pool->offset;
   return s < 1e-6f ? 1e-6f : s;
}
static void dn__pool_gather_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__pool_job *p = (const dn__pool_job *)job;
   size_t m, x;
   (void)worker;
   for (m = begin; m < end; m++) {
      size_t i = p->c->members[2 * m], j = p->c->members[2 * m + 1];
      const float *a = p->v + i * p->v_stride, *b = p->v + j * p->v_stride;
      float *to = p->y + m * p->y_stride;
      if (i == j) {
         for (x = 0; x < p->width; x++) to[x] = a[x];
      } else {
         float s = dn__pool_factor(p->pool, p->c, m);
         for (x = 0; x < p->width; x++) to[x] = s * (a[x] + b[x]); /* T 3.11 */
      }
   }
}
DN_API void dn_pool_gather(const dn_pool *pool, const dn_clusters *c, const float *v, size_t v_stride, size_t width,
                           float *coarse, size_t coarse_stride, const dn_parallel *parallel)
{
   dn__pool_job job = dn__pool_job_of(pool, NULL, c);
   job.v = v;
   job.v_stride = v_stride;
   job.y = coarse;
   job.y_stride = coarse_stride;
   job.width = width;
   dn__for(parallel, c->count, DN__GRAIN, dn__pool_gather_range, &job);
}
static void dn__pool_scatter_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__pool_job *p = (const dn__pool_job *)job;
   size_t i, x;
   (void)worker;
   for (i = begin; i < end; i++) {
      size_t m = p->c->cluster[i];
      const float *from = p->v + m * p->v_stride;
      float *to = p->y + i * p->y_stride;
      int alone = p->c->members[2 * m] == p->c->members[2 * m + 1];
      float s = alone ? 1.0f : 1.0f / dn__pool_factor(p->pool, p->c, m);
      for (x = 0; x < p->width; x++) to[x] = from[x] * s; /* T 3.12 */
   }
}
DN_API void dn_pool_scatter(const dn_pool *pool, const dn_clusters *c, const float *coarse, size_t coarse_stride,
                            size_t width, size_t nodes, float *v, size_t v_stride, const dn_parallel *parallel)
{
   dn__pool_job job = dn__pool_job_of(pool, NULL, c);
   job.v = coarse;
   job.v_stride = coarse_stride;
   job.y = v;
   job.y_stride = v_stride;
   job.width = width;
   dn__for(parallel, nodes, DN__GRAIN, dn__pool_scatter_range, &job);
}

/* ===================================================================================== >>networks
   in       an opened safetensors file                        out   dn_model: packed layers in run order
            rows (N,D) in the frame's scratch                       displacement (N,3) before output.std/mean
   touches  the memory handed in; a loaded model is never written again
   paper    DenseGATs T 3.2, MultiResGNet T 3.3, baselines T tables 3.3 and 3.4; spec section 5
   read     dn__build_model (what each architecture is made of), then dn__run_multiresgnet (how it runs) */

enum { DN__MAX_FEATURES = 16, DN__MAX_CHAIN = 64, DN__NAME = 64, DN__TILE = 128 };
typedef enum dn__kind { DN__LINEAR, DN__GAT_BLOCK } dn__kind;

typedef struct dn__block { /* one named layer */
   char name[DN__NAME];
   dn__kind kind;
   size_t in, out;
   dn_linear linear;
   dn_gat gat;
} dn__block;

struct dn_model {
   dn_model_info info;
   dn_feature features[DN__MAX_FEATURES];
   const dn_allocator *allocator; /* points at the copy below, or NULL: DN_MALLOC */
   dn_allocator allocator_copy;
   int owned;                     /* made by dn_model_load: dn_model_free gives the memory back */
   const float *input_mean, *input_scale; /* (D), scale = 1/std; NULL when absent */
   float output_mean[3], output_std[3];
   size_t block_count;
   dn__block *blocks;             /* in run order */
   size_t chain[3];               /* baselines: how many pre, gat and post blocks */
   dn_gat *dense;                 /* densegats 3 x 6, multiresgnet 2: copies in rows for dn_dense_run */
   dn_pool pool;                  /* multiresgnet */
};

/* --- loading. The builder runs twice over the same code: first measuring (arena without memory), then packing. */
typedef struct dn__loader {
   const dn_tensors *file;
   dn_error *err;
   dn_result failed;       /* first failure; everything after it does nothing */
   dn__arena memory;       /* the model's */
   dn__arena temp;         /* floats of one layer; reset for each */
   size_t temp_peak;
   dn_model *model;
   int packing;
} dn__loader;

static const char dn__where_model[] = "model";

static void dn__put_shape(dn__text *t, const size_t *shape, unsigned rank)
{
   unsigned i;
   dn__put(t, "(");
   for (i = 0; i < rank && i < 4; i++) {
      if (i) dn__put(t, ",");
      dn__put_size(t, shape[i]);
   }
   dn__put(t, rank > 4 ? ",...)" : ")"); /* dn_tensor keeps four sides */
}
static void dn__join(char *buffer, size_t size, const char *a, const char *b)
{
   dn__text t = dn__text_of(buffer, size);
   dn__put(&t, a);
   dn__put(&t, b);
}
static void dn__number(char *buffer, size_t size, const char *a, size_t n, const char *b)
{
   dn__text t = dn__text_of(buffer, size);
   dn__put(&t, a);
   dn__put_size(&t, n);
   dn__put(&t, b);
}

static void dn__load_fail(dn__loader *l, dn_result code, const char *name, const char *text)
{
   char line[240];
   dn__text t = dn__text_of(line, sizeof line);
   if (l->failed) return;
   dn__put(&t, name);
   dn__put(&t, text);
   l->failed = dn__fail(l->err, code, dn__where_model, SIZE_MAX, line);
}
/* The tensor of that name, of exactly that shape; 0 in `want` accepts any side from 1 to DN_MAX_DIM. NULL and an
   error that names both shapes otherwise. */
static const dn_tensor *dn__want(dn__loader *l, const char *name, unsigned rank, size_t want0, size_t want1)
{
   const dn_tensor *t;
   size_t want[2];
   unsigned i;
   int good;
   if (l->failed) return NULL;
   t = dn_tensors_find(l->file, name);
   if (!t) {
      dn__load_fail(l, DN_MISSING_TENSOR, name, ": not in the file");
      return NULL;
   }
   want[0] = want0;
   want[1] = want1;
   good = t->rank == rank;
   for (i = 0; good && i < rank; i++)
      good = want[i] ? t->shape[i] == want[i] : t->shape[i] >= 1 && t->shape[i] <= DN_MAX_DIM;
   if (!good) {
      char text[160];
      dn__text s = dn__text_of(text, sizeof text);
      dn__put(&s, ": expected (");
      for (i = 0; i < rank; i++) {
         if (i) dn__put(&s, ",");
         if (want[i]) dn__put_size(&s, want[i]);
         else dn__put(&s, "1..max");
      }
      dn__put(&s, "), file has ");
      dn__put_shape(&s, t->shape, t->rank);
      dn__load_fail(l, DN_BAD_SHAPE, name, text);
      return NULL;
   }
   if (t->format != DN_ST_F32 && t->format != DN_ST_F16 && t->format != DN_ST_BF16) {
      dn__load_fail(l, DN_BAD_TYPE, name, t->format == DN_ST_I32 ? ": expected F32, F16 or BF16, file has I32" : ": expected F32, F16 or BF16, file has another type");
      return NULL;
   }
   return t;
}
/* The tensor's numbers as floats in temporary memory; not finite is an error. NULL while measuring. */
static const float *dn__floats(dn__loader *l, const dn_tensor *t)
{
   float *out;
   size_t i;
   if (!t || l->failed) return NULL;
   out = (float *)dn__take(&l->temp, t->count, sizeof(float));
   l->temp_peak = dn__max(l->temp_peak, l->temp.used);
   if (l->model) l->model->info.parameters = dn__add(l->model->info.parameters, t->count);
   if (!l->packing) return NULL;
   DN_ASSERT(out);
   dn_tensor_floats(t, 0, t->count, out);
   for (i = 0; i < t->count; i++)
      if (!dn__finite(out[i])) {
         char text[80];
         dn__number(text, sizeof text, ": element ", i, " is not finite");
         dn__load_fail(l, DN_BAD_VALUE, t->name, text);
         return NULL;
      }
   return out;
}
/* name.bn.*, present when any of its four tensors is; then all four are wanted */
static int dn__batchnorm(dn__loader *l, const char *name, size_t channels, dn_batchnorm *bn)
{
   static const char *const parts[4] = { ".bn.weight", ".bn.bias", ".bn.running_mean", ".bn.running_var" };
   const float *data[4];
   char full[DN__NAME + 24];
   int i, any = 0;
   size_t c;
   for (i = 0; i < 4; i++) {
      dn__join(full, sizeof full, name, parts[i]);
      any |= dn_tensors_find(l->file, full) != NULL;
   }
   if (!any) return 0;
   for (i = 0; i < 4; i++) {
      dn__join(full, sizeof full, name, parts[i]);
      data[i] = dn__floats(l, dn__want(l, full, 1, channels, 0));
   }
   if (l->packing && !l->failed)
      for (c = 0; c < channels; c++)
         if (!(data[3][c] + 1e-5f > 0.0f)) {
            char text[80];
            dn__number(text, sizeof text, ": channel ", c, " is negative, expected a variance, at least 0");
            dn__load_fail(l, DN_BAD_VALUE, full, text); /* the first one is kept */
         }
   bn->weight = data[0];
   bn->bias = data[1];
   bn->mean = data[2];
   bn->var = data[3];
   return 1;
}
static dn__block *dn__next_block(dn__loader *l, const char *name, dn__kind kind, dn__block *spare)
{
   dn__block *b = l->packing ? &l->model->blocks[l->model->block_count] : spare;
   l->model->block_count++;
   memset(b, 0, sizeof *b);
   dn__join(b->name, sizeof b->name, name, "");
   b->kind = kind;
   l->temp.used = 0;
   return b;
}
/* A linear layer by name; in = 0 takes whatever width the file has. Returns its output width. */
static size_t dn__add_linear(dn__loader *l, const char *name, size_t *in, size_t out, dn_activation act)
{
   dn__block spare, *b;
   char full[DN__NAME + 24];
   const dn_tensor *w;
   const float *weight, *bias = NULL;
   dn_batchnorm bn;
   int has_bn;
   void *memory;
   if (l->failed) return 0;
   b = dn__next_block(l, name, DN__LINEAR, &spare);
   dn__join(full, sizeof full, name, ".weight");
   w = dn__want(l, full, 2, out, *in);
   if (!w) return 0;
   b->out = w->shape[0];
   b->in = *in = w->shape[1];
   weight = dn__floats(l, w);
   dn__join(full, sizeof full, name, ".bias");
   if (dn_tensors_find(l->file, full)) bias = dn__floats(l, dn__want(l, full, 1, b->out, 0));
   has_bn = dn__batchnorm(l, name, b->out, &bn);
   memory = dn__take(&l->memory, dn_linear_size(b->in, b->out), 1);
   if (l->packing && !l->failed) dn_linear_pack(&b->linear, b->in, b->out, weight, bias, has_bn ? &bn : NULL, act, memory);
   return b->out;
}
/* A GAT block by name: K and F from att_dst, B from self.weight (absent: a plain layer) */
static size_t dn__add_gat(dn__loader *l, const char *name, size_t *in, dn_activation act)
{
   dn__block spare, *b;
   char full[DN__NAME + 24];
   const dn_tensor *dst, *src, *lin, *self = NULL;
   const float *f_lin, *f_dst, *f_src, *f_self = NULL;
   size_t heads, features, selfs = 0;
   dn_batchnorm bn;
   int has_bn;
   void *memory;
   if (l->failed) return 0;
   b = dn__next_block(l, name, DN__GAT_BLOCK, &spare);
   dn__join(full, sizeof full, name, ".att_dst");
   dst = dn__want(l, full, 2, 0, 0);
   if (!dst) return 0;
   heads = dst->shape[0];
   features = dst->shape[1];
   dn__join(full, sizeof full, name, ".att_src");
   src = dn__want(l, full, 2, heads, features);
   dn__join(full, sizeof full, name, ".lin.weight");
   lin = dn__want(l, full, 2, dn__mul(heads, features), *in);
   if (!lin) return 0;
   *in = lin->shape[1];
   dn__join(full, sizeof full, name, ".self.weight");
   if (dn_tensors_find(l->file, full)) {
      self = dn__want(l, full, 2, 0, *in);
      if (!self) return 0;
      selfs = self->shape[0];
   }
   b->in = *in;
   b->out = dn__add(dn__mul(heads, features), selfs);
   f_lin = dn__floats(l, lin);
   f_dst = dn__floats(l, dst);
   f_src = dn__floats(l, src);
   if (self) f_self = dn__floats(l, self);
   has_bn = dn__batchnorm(l, name, b->out, &bn);
   memory = dn__take(&l->memory, dn_gat_size(b->in, heads, features, selfs), 1);
   if (l->packing && !l->failed)
      dn_gat_pack(&b->gat, b->in, heads, features, selfs, f_lin, f_dst, f_src, f_self, has_bn ? &bn : NULL, act, memory);
   return b->out;
}
static void dn__add_pool(dn__loader *l, const char *name, size_t in)
{
   char full[DN__NAME + 24];
   const dn_tensor *lin, *dst, *src;
   const float *f_lin, *f_dst, *f_src, *f_offset = NULL;
   void *memory;
   if (l->failed) return;
   l->temp.used = 0;
   dn__join(full, sizeof full, name, ".lin.weight");
   lin = dn__want(l, full, 2, 0, in);
   if (!lin) return;
   dn__join(full, sizeof full, name, ".att_dst");
   dst = dn__want(l, full, 2, 1, lin->shape[0]);
   dn__join(full, sizeof full, name, ".att_src");
   src = dn__want(l, full, 2, 1, lin->shape[0]);
   f_lin = dn__floats(l, lin);
   f_dst = dn__floats(l, dst);
   f_src = dn__floats(l, src);
   dn__join(full, sizeof full, name, ".offset");
   if (dn_tensors_find(l->file, full)) f_offset = dn__floats(l, dn__want(l, full, 1, 1, 0));
   memory = dn__take(&l->memory, dn_pool_size(in, lin->shape[0]), 1);
   if (l->packing && !l->failed)
      dn_pool_pack(&l->model->pool, in, lin->shape[0], f_lin, f_dst, f_src, f_offset ? f_offset[0] : 0.0f, memory);
}

/* pre.N, gat.N or post.N as many as the file has, from 0 without gaps */
static size_t dn__add_chain(dn__loader *l, const char *stem, dn__kind kind, size_t *first_in, size_t width, size_t *count)
{
   size_t n;
   for (n = 0; !l->failed; n++) {
      char name[DN__NAME], probe[DN__NAME + 24];
      size_t in = width;
      dn__number(name, sizeof name, stem, n, "");
      dn__join(probe, sizeof probe, name, kind == DN__LINEAR ? ".weight" : ".lin.weight");
      if (!dn_tensors_find(l->file, probe)) break;
      if (n == DN__MAX_CHAIN) {
         dn__load_fail(l, DN_UNSUPPORTED, name, ": more than 64 layers of one kind");
         break;
      }
      width = kind == DN__LINEAR ? dn__add_linear(l, name, &in, 0, DN_ACT_TANH) : dn__add_gat(l, name, &in, DN_ACT_TANH);
      if (*first_in == 0) *first_in = in;
   }
   *count = n;
   return width;
}

/* What each architecture is made of, in run order. Widths come from the tensors, structure from here (spec
   section 5). Returns D, the width of a feature row. */
static size_t dn__build_model(dn__loader *l, dn_arch arch)
{
   size_t in = 0, w, out_in, k, b;
   char name[DN__NAME];
   dn_model *m = l->model;
   if (arch == DN_DENSEGATS) { /* T 3.2 */
      w = dn__add_linear(l, "pre.0", &in, 0, DN_ACT_TANH);
      w = dn__add_linear(l, "pre.1", &w, 0, DN_ACT_TANH);
      for (k = 0; k < 3; k++) {
         for (b = 0; b < 6; b++) {
            size_t f;
            dn__number(name, sizeof name, "dense.", k, ".");
            dn__number(name + strlen(name), sizeof name - strlen(name), "", b, "");
            f = dn__add_gat(l, name, &w, DN_ACT_TANHSHRINK); /* T 3.6: the next block reads f_b || x_b */
            w = dn__add(w, f);
         }
         if (k == 2) break;
         dn__number(name, sizeof name, "transition.", k, "");
         w = dn__add_gat(l, name, &w, DN_ACT_TANHSHRINK);
      }
   } else if (arch == DN_MULTIRESGNET) { /* T 3.3, 3.13 */
      size_t pre, local, coarse;
      w = dn__add_linear(l, "pre.0", &in, 0, DN_ACT_TANH);
      pre = local = dn__add_linear(l, "pre.1", &w, 0, DN_ACT_TANH);
      for (b = 0; b < 2; b++) {
         size_t f;
         dn__number(name, sizeof name, "local.", b, "");
         f = dn__add_gat(l, name, &local, DN_ACT_TANHSHRINK);
         local = dn__add(local, f);
      }
      dn__add_pool(l, "pool", pre);
      coarse = pre;
      for (b = 0; b < 3; b++) {
         dn__number(name, sizeof name, "global.", b, "");
         coarse = dn__add_gat(l, name, &coarse, DN_ACT_TANHSHRINK);
      }
      w = dn__add(local, coarse);
   } else { /* baselines */
      m->chain[0] = m->chain[1] = m->chain[2] = 0;
      w = 0;
      if (arch != DN_GAT) w = dn__add_chain(l, "pre.", DN__LINEAR, &in, w, &m->chain[0]);
      if (arch != DN_MLP) w = dn__add_chain(l, "gat.", DN__GAT_BLOCK, &in, w, &m->chain[1]);
      if (arch == DN_NEUROSKINNING) w = dn__add_chain(l, "post.", DN__LINEAR, &in, w, &m->chain[2]);
   }
   if (arch == DN_DENSEGATS || arch == DN_MULTIRESGNET) {
      w = dn__add_linear(l, "post.0", &w, 0, DN_ACT_TANH);
      w = dn__add_linear(l, "post.1", &w, 0, DN_ACT_TANH);
   }
   out_in = w;
   dn__add_linear(l, "out", &out_in, 3, DN_ACT_NONE);
   return in ? in : out_in;
}

/* --- metadata */
static const char *dn__meta(dn__loader *l, const char *key, const char *absent)
{
   const char *v = dn_tensors_meta(l->file, key);
   if (!v && !absent) dn__load_fail(l, DN_MISSING_TENSOR, key, ": missing from __metadata__");
   return v ? v : absent;
}
static void dn__meta_fail(dn__loader *l, const char *key, const char *found, const char *expected)
{
   char line[200];
   dn__text t = dn__text_of(line, sizeof line);
   dn__put(&t, ": found \"");
   { /* the value may be long: its first part is enough to find it */
      char part[64];
      dn__text p = dn__text_of(part, sizeof part);
      dn__put(&p, found);
      dn__put(&t, part);
   }
   dn__put(&t, "\", expected ");
   dn__put(&t, expected);
   dn__load_fail(l, DN_UNSUPPORTED, key, line);
}
/* a plain decimal such as "0.01", "1e-3" or "100", read the same in every locale; anything else is 0 */
static float dn__decimal(const char *s)
{
   double v = 0.0, unit = 1.0;
   int digits = 0, e = 0, negative = 0;
   for (; *s >= '0' && *s <= '9'; s++, digits++) v = v * 10.0 + (*s - '0');
   if (*s == '.')
      for (s++; *s >= '0' && *s <= '9'; s++, digits++) unit *= 0.1, v += unit * (*s - '0');
   if (digits && (*s == 'e' || *s == 'E')) {
      s++;
      negative = *s == '-';
      if (*s == '-' || *s == '+') s++;
      for (; *s >= '0' && *s <= '9'; s++)
         if (e < 60) e = e * 10 + (*s - '0');
      for (; e > 0; e--) v = negative ? v * 0.1 : v * 10.0;
   }
   return digits && !*s && v < 1e30 ? (float)v : 0.0f;
}
static const struct { const char *name; dn_feature feature; } dn__feature_names[] = {
   { "position", DN_POSITION }, { "relative", DN_RELATIVE }, { "normal", DN_NORMAL },
   { "geodesic", DN_GEODESIC }, { "distance", DN_DISTANCE }
};
static const char *const dn__arch_names[] = { "mlp", "gat", "neuroskinning", "densegats", "multiresgnet" };

static void dn__load_features(dn__loader *l)
{
   static const char key[] = "deformnet.features";
   dn_model *m = l->model;
   const char *s = dn__meta(l, key, NULL);
   while (s && !l->failed) {
      const char *end = s;
      size_t i, n = sizeof dn__feature_names / sizeof *dn__feature_names;
      while (*end && *end != ',') end++;
      for (i = 0; i < n; i++)
         if (strlen(dn__feature_names[i].name) == (size_t)(end - s) && !memcmp(s, dn__feature_names[i].name, (size_t)(end - s)))
            break;
      if (i == n) dn__meta_fail(l, key, s, "position, relative, normal, geodesic, distance");
      else if (m->info.feature_count == DN__MAX_FEATURES) dn__load_fail(l, DN_UNSUPPORTED, key, ": more than 16 features");
      else m->features[m->info.feature_count++] = dn__feature_names[i].feature;
      s = *end ? end + 1 : NULL;
   }
}
/* The joint names, split at commas into the model's memory, and how many columns a per-joint feature has. */
static void dn__load_joints(dn__loader *l, size_t row_width)
{
   dn_model *m = l->model;
   const char *list = dn_tensors_meta(l->file, "deformnet.joints");
   size_t narrow = 0, wide = 0, names = 0, i, length, joints = 0;
   for (i = 0; i < m->info.feature_count; i++) {
      if (m->features[i] == DN_GEODESIC || m->features[i] == DN_DISTANCE) wide++;
      else narrow += 3;
   }
   if (list && *list) {
      char *text;
      const char **table;
      for (names = 1, length = 0; list[length]; length++) names += list[length] == ',';
      if (names > DN_MAX_DIM) { /* bind compares each with the character's */
         char line[120];
         dn__number(line, sizeof line, ": found ", names, " names, expected at most DN_MAX_DIM");
         dn__load_fail(l, DN_BAD_SHAPE, "deformnet.joints", line);
         return;
      }
      text = (char *)dn__take(&l->memory, dn__add(length, 1), 1);
      table = (const char **)dn__take(&l->memory, names, sizeof *table);
      if (l->packing && !l->failed) {
         size_t k = 0;
         memcpy(text, list, length + 1);
         table[k++] = text;
         for (i = 0; i < length; i++)
            if (text[i] == ',') text[i] = 0, table[k++] = text + i + 1;
         m->info.joint_names = table;
      }
      joints = names;
   }
   if (l->failed) return;
   if (wide) joints = row_width > narrow && (row_width - narrow) % wide == 0 ? (row_width - narrow) / wide : 0;
   if (wide ? joints == 0 || (names && joints != names) : row_width != narrow) {
      char line[160];
      dn__text t = dn__text_of(line, sizeof line);
      dn__put(&t, ": the first layer takes rows of ");
      dn__put_size(&t, row_width);
      dn__put(&t, ", the features make ");
      dn__put_size(&t, narrow);
      dn__put(&t, " + ");
      dn__put_size(&t, wide);
      dn__put(&t, " x joints, deformnet.joints names ");
      dn__put_size(&t, names);
      dn__load_fail(l, DN_BAD_SHAPE, "deformnet.features", line);
   }
   m->info.joints = joints;
}
static const char *dn__keep_string(dn__loader *l, const char *s)
{
   size_t n = strlen(s) + 1;
   char *copy = (char *)dn__take(&l->memory, n, 1);
   if (!l->packing || !copy) return "";
   memcpy(copy, s, n);
   return copy;
}
/* a tensor [width] that may be absent; NULL then, and while measuring */
static const float *dn__maybe(dn__loader *l, const char *name, size_t width)
{
   return dn_tensors_find(l->file, name) ? dn__floats(l, dn__want(l, name, 1, width, 0)) : NULL;
}
/* x -> (x - mean) / std before the first layer and x std + mean after the last, where the file has them */
static void dn__load_scales(dn__loader *l, size_t row_width)
{
   dn_model *m = l->model;
   size_t i;
   l->temp.used = 0;
   for (i = 0; i < 3; i++) m->output_mean[i] = 0.0f, m->output_std[i] = 1.0f;
   if (dn_tensors_find(l->file, "input.mean") || dn_tensors_find(l->file, "input.std")) {
      const float *mean = dn__maybe(l, "input.mean", row_width), *std = dn__maybe(l, "input.std", row_width);
      float *kept_mean = (float *)dn__take(&l->memory, row_width, sizeof(float));
      float *kept_scale = (float *)dn__take(&l->memory, row_width, sizeof(float));
      if (l->packing && !l->failed) {
         for (i = 0; i < row_width; i++) {
            kept_mean[i] = mean ? mean[i] : 0.0f;
            kept_scale[i] = std ? 1.0f / std[i] : 1.0f;
            if (!dn__finite(kept_scale[i])) {
               char text[80];
               dn__number(text, sizeof text, ": element ", i, " is zero or too small to divide by");
               dn__load_fail(l, DN_BAD_VALUE, "input.std", text);
            }
         }
         m->input_mean = kept_mean;
         m->input_scale = kept_scale;
      }
   }
   {
      const float *mean = dn__maybe(l, "output.mean", 3), *std = dn__maybe(l, "output.std", 3);
      if (l->packing && !l->failed)
         for (i = 0; i < 3; i++) m->output_mean[i] = mean ? mean[i] : 0.0f, m->output_std[i] = std ? std[i] : 1.0f;
   }
}

/* One run of the builder: metadata, layers, scales. model is the real one when packing, a stand-in when measuring. */
static void dn__load_all(dn__loader *l, size_t blocks)
{
   dn_model *m = l->model;
   size_t arch, row_width, archs = sizeof dn__arch_names / sizeof *dn__arch_names;
   const char *s = dn__meta(l, "deformnet.version", NULL);
   if (s && !dn__name_equal(s, "1")) dn__meta_fail(l, "deformnet.version", s, "1");
   s = dn__meta(l, "deformnet.arch", NULL);
   if (l->failed) return;
   for (arch = 0; arch < archs && !dn__name_equal(s, dn__arch_names[arch]); arch++) {}
   if (arch == archs) {
      dn__meta_fail(l, "deformnet.arch", s, "mlp, gat, neuroskinning, densegats, multiresgnet");
      return;
   }
   m->info.arch = (dn_arch)arch;
   m->info.arch_name = dn__arch_names[arch];
   dn__load_features(l);
   s = dn__meta(l, "deformnet.frame", "model");
   if (!dn__name_equal(s, "model") && !dn__name_equal(s, "root")) dn__meta_fail(l, "deformnet.frame", s, "model, root");
   m->info.root_frame = dn__name_equal(s, "root");
   s = dn__meta(l, "deformnet.pooling", "dynamic");
   if (!dn__name_equal(s, "dynamic") && !dn__name_equal(s, "rest")) dn__meta_fail(l, "deformnet.pooling", s, "dynamic, rest");
   m->info.pooling = dn__name_equal(s, "rest") ? DN_POOL_REST : DN_POOL_DYNAMIC;
   s = dn__meta(l, "deformnet.unit", "1");
   m->info.unit = dn__decimal(s);
   if (!(m->info.unit > 0.0f)) dn__meta_fail(l, "deformnet.unit", s, "metres per unit, more than 0");
   m->info.licence = dn__keep_string(l, dn__meta(l, "deformnet.licence", ""));
   m->info.trained_on = dn__keep_string(l, dn__meta(l, "deformnet.trained_on", ""));
   m->blocks = (dn__block *)dn__take(&l->memory, blocks, sizeof(dn__block));
   m->dense = (dn_gat *)dn__take(&l->memory, 18, sizeof(dn_gat));
   if (l->failed) return;
   row_width = dn__build_model(l, m->info.arch);
   if (l->failed) return;
   dn__load_joints(l, row_width);
   dn__load_scales(l, row_width);
   m->info.row_width = row_width;
}
static size_t dn__copy_dense(dn_model *m) /* dn_dense_run wants a module's blocks in a row */
{
   size_t i, n = 0;
   for (i = 0; i < m->block_count; i++)
      if (!strncmp(m->blocks[i].name, "dense.", 6) || !strncmp(m->blocks[i].name, "local.", 6)) m->dense[n++] = m->blocks[i].gat;
   return n;
}
/* Measure (memory NULL) or pack. On measuring *bytes and *scratch are written. */
static dn_result dn__load(const dn_tensors *file, void *memory, size_t *bytes, void *scratch, size_t *scratch_bytes,
                          size_t *blocks, dn_model **model, dn_error *err)
{
   dn__loader l;
   dn_model stand_in;
   memset(&l, 0, sizeof l);
   memset(&stand_in, 0, sizeof stand_in);
   l.file = file;
   l.err = err;
   l.packing = memory != NULL;
   l.memory = dn__arena_of(memory, memory ? *bytes : SIZE_MAX);
   l.temp = dn__arena_of(scratch, memory ? *scratch_bytes : SIZE_MAX);
   l.model = (dn_model *)dn__take(&l.memory, 1, sizeof(dn_model));
   if (l.packing) memset(l.model, 0, sizeof *l.model);
   else l.model = &stand_in;
   dn__load_all(&l, *blocks);
   if (l.failed) return l.failed;
   if (!l.packing) { /* the block table was measured empty: its size is known only now */
      *blocks = stand_in.block_count;
      *bytes = dn__add(l.memory.used, dn__round(dn__mul(*blocks, sizeof(dn__block)), DN__ALIGN));
      *scratch_bytes = dn__max(l.temp_peak, DN__ALIGN);
      return *bytes == SIZE_MAX || *scratch_bytes == SIZE_MAX ? dn__fail(err, DN_NO_MEMORY, dn__where_model, SIZE_MAX, "sizes overflow") : DN_OK;
   }
   dn__copy_dense(l.model);
   l.model->info.features = l.model->features;
   l.model->info.bytes = l.memory.used;
   *model = l.model;
   return DN_OK;
}

DN_API dn_result dn_model_size(const dn_tensors *file, size_t *bytes, size_t *scratch, dn_error *err)
{
   size_t blocks = 0;
   DN_ASSERT(file && bytes && scratch);
   return dn__load(file, NULL, bytes, NULL, scratch, &blocks, NULL, err);
}
DN_API dn_result dn_model_init(const dn_tensors *file, void *memory, size_t bytes, void *scratch, size_t scratch_bytes,
                               dn_model **model, dn_error *err)
{
   size_t need = 0, need_scratch = 0, blocks = 0;
   dn_result r;
   DN_ASSERT(file && memory && scratch && model && ((uintptr_t)memory & 63) == 0 && ((uintptr_t)scratch & 63) == 0);
   *model = NULL;
   r = dn__load(file, NULL, &need, NULL, &need_scratch, &blocks, NULL, err);
   if (r) return r;
   if (bytes < need) return dn__fail_sizes(err, DN_TOO_SMALL, dn__where_model, SIZE_MAX, "memory: ", bytes, " bytes given, needed ", need, NULL);
   if (scratch_bytes < need_scratch)
      return dn__fail_sizes(err, DN_TOO_SMALL, dn__where_model, SIZE_MAX, "scratch: ", scratch_bytes, " bytes given, needed ", need_scratch, NULL);
   return dn__load(file, memory, &bytes, scratch, &scratch_bytes, &blocks, model, err);
}
DN_API dn_model *dn_model_load(const void *file, size_t size, const dn_allocator *allocator, dn_error *err)
{
   dn_tensors *tensors = NULL;
   dn_model *model = NULL;
   void *table, *memory = NULL, *scratch = NULL;
   size_t table_bytes = 0, bytes = 0, scratch_bytes = 0;
   if (dn_tensors_size(file, size, &table_bytes, err)) return NULL;
   table = dn__alloc(allocator, table_bytes);
   if (!table) {
      dn__fail_sizes(err, DN_NO_MEMORY, dn__where_model, SIZE_MAX, "tensor table of ", table_bytes, NULL, 0, " bytes");
      return NULL;
   }
   if (!dn_tensors_open(file, size, table, table_bytes, &tensors, err) && !dn_model_size(tensors, &bytes, &scratch_bytes, err)) {
      memory = dn__alloc(allocator, bytes);
      scratch = memory ? dn__alloc(allocator, scratch_bytes) : NULL;
      if (!scratch) dn__fail_sizes(err, DN_NO_MEMORY, dn__where_model, SIZE_MAX, "model of ", bytes, " bytes and scratch of ", scratch_bytes, " bytes");
      else dn_model_init(tensors, memory, bytes, scratch, scratch_bytes, &model, err);
   }
   dn__release(allocator, scratch, scratch_bytes);
   if (model) {
      model->owned = 1;
      model->info.bytes = bytes; /* what free is told */
      if (allocator) model->allocator_copy = *allocator, model->allocator = &model->allocator_copy;
   } else dn__release(allocator, memory, bytes);
   dn__release(allocator, table, table_bytes);
   return model;
}
DN_API void dn_model_free(dn_model *model)
{
   if (model && model->owned) {
      dn_allocator a = model->allocator_copy; /* the copy inside goes with the memory */
      dn__release(model->allocator ? &a : NULL, model, model->info.bytes);
   }
}
DN_API void dn_model_describe(const dn_model *model, dn_model_info *info) { *info = model->info; }

#ifndef DN_NO_STDIO
/* the length of an open file, or SIZE_MAX */
static size_t dn__file_size(FILE *f)
{
   long n;
   if (fseek(f, 0, SEEK_END)) return SIZE_MAX;
   n = ftell(f);
   if (n < 0 || (unsigned long)n == (unsigned long)-1 / 2) return SIZE_MAX; /* a directory, where it opens, is LONG_MAX long */
   return fseek(f, 0, SEEK_SET) ? SIZE_MAX : (size_t)n;
}
static void dn__file_fail(dn_error *err, dn_result code, const char *path, const char *text)
{
   char line[240];
   dn__text t = dn__text_of(line, sizeof line);
   dn__put(&t, text); /* first: a long path is cut */
   dn__put(&t, path);
   dn__fail(err, code, "model file", SIZE_MAX, line);
}
DN_API dn_model *dn_model_load_file(const char *path, const dn_allocator *allocator, dn_error *err)
{
   dn_model *model = NULL;
   FILE *f = fopen(path, "rb");
   size_t size = f ? dn__file_size(f) : SIZE_MAX;
   unsigned char *bytes = NULL;
   if (!f) dn__file_fail(err, DN_IO, path, "cannot open ");
   else if (size == SIZE_MAX) dn__file_fail(err, DN_IO, path, "cannot find the length of ");
   else if (size == 0) dn__file_fail(err, DN_TRUNCATED, path, "found 0 bytes, expected at least 8 in ");
   else if (!(bytes = (unsigned char *)dn__alloc(allocator, size))) dn__file_fail(err, DN_NO_MEMORY, path, "no memory for the bytes of ");
   else if (fread(bytes, 1, size, f) != size) dn__file_fail(err, DN_IO, path, "cannot read all of ");
   else model = dn_model_load(bytes, size, allocator, err);
   dn__release(allocator, bytes, size);
   if (f) fclose(f);
   return model;
}
#endif

/* --- running. Widths and buffers first: one place says what a frame needs, the runners below only use it. */
typedef struct dn__net { /* scratch of one evaluation, carved by dn__net_layout */
   float *wide;          /* (N, wide_width): the dense row; baselines: ping */
   float *side;          /* (N, side_width): narrow stages, unpooled rows; baselines: pong */
   float *coarse[2];     /* (M<=N, coarse_width) */
   void *gat;            /* the largest block's product */
   float *tile;          /* (workers, DN__TILE, tile_width): the point-wise layers at the end */
   size_t wide_width, side_width, coarse_width, tile_width;
   float *scores;        /* (2E) dynamic pooling only */
   void *pool;           /* dynamic pooling: scratch of scores and contraction */
   dn_clusters clusters; /* dynamic: all arrays here; rest: only score is, the rest is the rig's */
} dn__net;

static size_t dn__block_scratch(const dn_model *m, size_t nodes)
{
   size_t i, need = 0;
   for (i = 0; i < m->block_count; i++)
      if (m->blocks[i].kind == DN__GAT_BLOCK) need = dn__max(need, dn_gat_scratch(&m->blocks[i].gat, nodes));
   return need;
}
static void dn__clusters_layout(dn_clusters *c, size_t nodes, size_t neighbours, dn__arena *a)
{
   c->members = (uint32_t *)dn__take(a, dn__mul(nodes, 2), sizeof(uint32_t));
   c->cluster = (uint32_t *)dn__take(a, nodes, sizeof(uint32_t));
   c->coarse_first = (uint32_t *)dn__take(a, dn__add(nodes, 1), sizeof(uint32_t));
   c->coarse_next = (uint32_t *)dn__take(a, neighbours, sizeof(uint32_t));
}
/* rest: a contraction found at bind, or NULL when there is none (dynamic pooling, and bind itself looking for it).
   neighbours = 2E. */
static void dn__net_layout(dn__net *n, const dn_model *m, size_t nodes, size_t neighbours, const dn_clusters *rest,
                           unsigned workers, dn__arena *a)
{
   const dn__block *b = m->blocks;
   size_t last = m->block_count - 1, i;
   memset(n, 0, sizeof *n);
   if (m->info.arch == DN_DENSEGATS) { /* b: pre 0-1, dense 2-7, transition 8, dense 9-14, transition 15, dense 16-21 */
      n->wide_width = dn__max(dn__max(b[7].in + b[7].out, b[14].in + b[14].out), b[21].in + b[21].out);
      n->side_width = dn__max(dn__max(b[0].out, b[8].out), b[15].out);
      n->tile_width = b[last - 1].in + b[last].in;
   } else if (m->info.arch == DN_MULTIRESGNET) { /* b: pre 0-1, local 2-3, global 4-6, post 7-8, out 9 */
      n->wide_width = b[7].in; /* local || global */
      n->side_width = dn__max(b[0].out, b[5].out);
      n->coarse_width = dn__max(b[1].out, dn__max(b[4].out, b[5].out));
      n->tile_width = b[last - 1].in + b[last].in;
   } else {
      for (i = 0; i < last; i++) n->wide_width = dn__max(n->wide_width, b[i].out);
      n->side_width = n->wide_width;
   }
   n->wide = (float *)dn__take(a, dn__mul(nodes, n->wide_width), sizeof(float));
   n->side = (float *)dn__take(a, dn__mul(nodes, n->side_width), sizeof(float));
   n->gat = dn__take(a, dn__block_scratch(m, nodes), 1);
   n->tile = (float *)dn__take(a, dn__mul(dn__mul(workers, DN__TILE), n->tile_width), sizeof(float));
   if (m->info.arch != DN_MULTIRESGNET) return;
   n->coarse[0] = (float *)dn__take(a, dn__mul(nodes, n->coarse_width), sizeof(float));
   n->coarse[1] = (float *)dn__take(a, dn__mul(nodes, n->coarse_width), sizeof(float));
   if (rest) n->clusters = *rest;
   n->clusters.score = (float *)dn__take(a, nodes, sizeof(float));
   if (rest) return;
   n->scores = (float *)dn__take(a, neighbours, sizeof(float));
   n->pool = dn__take(a, dn_pool_scratch(nodes, neighbours), 1);
   dn__clusters_layout(&n->clusters, nodes, neighbours, a);
}

typedef struct dn__run { /* what every runner needs at hand */
   const dn_model *m;
   const dn_graph *g;
   const dn__net *n;
   const dn_parallel *par;
   const dn_probe *probe;
} dn__run;

static void dn__tap(const dn__run *r, const char *name, const float *rows, size_t first, size_t count, size_t width, size_t stride)
{
   if (r->probe && r->probe->tap) r->probe->tap(r->probe->user, name, rows, first, count, width, stride);
}
static void dn__run_block(const dn__run *r, const dn__block *b, const dn_graph *g, const float *x, size_t x_stride, float *y, size_t y_stride)
{
   if (b->kind == DN__LINEAR) dn_linear_run(&b->linear, x, x_stride, g->nodes, y, y_stride, r->par);
   else dn_gat_run(&b->gat, g, x, x_stride, y, y_stride, r->n->gat, r->par);
   dn__tap(r, b->name, y, 0, g->nodes, b->out, y_stride);
}

/* post.0, post.1, out on tiles of nodes: half of a network's arithmetic, whose rows never leave the cache */
typedef struct dn__tail_job { const dn__run *r; const float *x; size_t x_stride; float *y; } dn__tail_job;
static void dn__tail_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__tail_job *j = (const dn__tail_job *)job;
   const dn__run *r = j->r;
   const dn__block *b = &r->m->blocks[r->m->block_count - 3];
   float *t0 = r->n->tile + worker * DN__TILE * r->n->tile_width, *t1 = t0 + DN__TILE * b[0].out;
   DN_ASSERT(worker < dn__workers(r->par)); /* the caller's job system numbers them; scratch has no more tiles */
   for (; begin < end; begin += DN__TILE) {
      size_t n = dn__min(DN__TILE, end - begin);
      dn_linear_run(&b[0].linear, j->x + begin * j->x_stride, j->x_stride, n, t0, b[0].out, NULL);
      dn_linear_run(&b[1].linear, t0, b[0].out, n, t1, b[1].out, NULL);
      dn_linear_run(&b[2].linear, t1, b[1].out, n, j->y + begin * 3, 3, NULL);
      dn__tap(r, b[0].name, t0, begin, n, b[0].out, b[0].out);
      dn__tap(r, b[1].name, t1, begin, n, b[1].out, b[1].out);
      dn__tap(r, b[2].name, j->y + begin * 3, begin, n, 3, 3);
   }
}
static void dn__run_tail(const dn__run *r, const float *x, size_t x_stride, float *y)
{
   dn__tail_job j;
   j.r = r;
   j.x = x;
   j.x_stride = x_stride;
   j.y = y;
   dn__for(r->probe ? NULL : r->par, r->g->nodes, DN__TILE, dn__tail_range, &j);
}

/* `count` GAT blocks as a dense module in the first `width` columns of rows (T 3.6); taps each block's columns */
static void dn__run_dense(const dn__run *r, size_t first_block, const dn_gat *blocks, size_t count, float *rows, size_t stride, size_t width)
{
   size_t i, at = width - blocks[0].in;
   dn_dense_run(blocks, count, r->g, rows, stride, width, r->n->gat, r->par);
   for (i = 0; i < count; i++) {
      const dn__block *b = &r->m->blocks[first_block + i];
      at -= b->out;
      dn__tap(r, b->name, rows + at, 0, r->g->nodes, b->out, stride);
   }
}
typedef struct dn__copy_job { const float *x; float *y; size_t x_stride, y_stride, width; } dn__copy_job;
static void dn__copy_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__copy_job *j = (const dn__copy_job *)job;
   size_t i;
   (void)worker;
   for (i = begin; i < end; i++) memcpy(j->y + i * j->y_stride, j->x + i * j->x_stride, j->width * sizeof(float));
}

/* DenseGATs (T 3.2): 32 -> 464 -> 72 -> 504 -> 72 -> 504 -> 512 -> 128 -> 3 at the paper's size */
static void dn__run_densegats(const dn__run *r, const float *rows, float *y)
{
   const dn__net *n = r->n;
   const dn__block *b = r->m->blocks;
   size_t k, width = 0, stride = n->wide_width;
   dn__run_block(r, &b[0], r->g, rows, r->m->info.row_width, n->side, b[0].out);
   for (k = 0; k < 3; k++) {
      const dn__block *into = &b[1 + 7 * k]; /* pre.1, transition.0, transition.1: what a dense module starts from */
      width = b[7 + 7 * k].in + b[7 + 7 * k].out;
      if (k == 0) dn__run_block(r, into, r->g, n->side, b[0].out, n->wide + width - into->out, stride);
      else { /* a block may not write over its own input: through the side rows */
         dn__copy_job c;
         dn__run_block(r, into, r->g, n->wide, stride, n->side, into->out);
         c.x = n->side, c.x_stride = into->out, c.y = n->wide + width - into->out, c.y_stride = stride, c.width = into->out;
         dn__for(r->par, r->g->nodes, DN__TILE, dn__copy_range, &c);
      }
      dn__run_dense(r, 2 + 7 * k, r->m->dense + 6 * k, 6, n->wide, stride, width);
   }
   dn__run_tail(r, n->wide, stride, y);
}

/* pre.0 and pre.1 of MultiResGNet: also all that the search for rest-pose clusters needs. The wide row is
   [ local.1 | local.0 | pre.1 || global.2 ]: pre.1 is written where the dense module expects its x_0. */
static const float *dn__run_pre(const dn__run *r, const float *rows)
{
   const dn__block *b = r->m->blocks;
   float *x = r->n->wide + (r->n->wide_width - b[6].out - b[1].out);
   dn__run_block(r, &b[0], r->g, rows, r->m->info.row_width, r->n->side, b[0].out);
   dn__run_block(r, &b[1], r->g, r->n->side, b[0].out, x, r->n->wide_width);
   return x;
}
/* MultiResGNet (T 3.3): a local branch on the mesh, a global one on the contracted mesh, side by side */
static void dn__run_multiresgnet(const dn__run *r, const float *rows, float *y)
{
   const dn__net *n = r->n;
   const dn__block *b = r->m->blocks;
   size_t stride = n->wide_width, local = stride - b[6].out;
   dn_clusters c = n->clusters; /* dynamic pooling sets count and graph in this copy; the arrays are scratch */
   const float *x = dn__run_pre(r, rows);
   if (n->scores) {
      dn_pool_scores(&r->m->pool, r->g, x, stride, n->scores, n->pool, r->par);
      dn_pool_contract(r->g, n->scores, &c, n->pool);
   } else dn_pool_rescore(&r->m->pool, r->g, x, stride, &c, r->par);
   dn_pool_gather(&r->m->pool, &c, x, stride, b[1].out, n->coarse[0], b[1].out, r->par);
   dn__tap(r, "pool", n->coarse[0], 0, c.count, b[1].out, b[1].out);
   if (r->probe && r->probe->pool) r->probe->pool(r->probe->user, "pool", c.members, c.score, c.count);
   dn__run_dense(r, 2, r->m->dense, 2, n->wide, stride, local);
   dn__run_block(r, &b[4], &c.graph, n->coarse[0], b[1].out, n->coarse[1], b[4].out);
   dn__run_block(r, &b[5], &c.graph, n->coarse[1], b[4].out, n->coarse[0], b[5].out);
   dn_pool_scatter(&r->m->pool, &c, n->coarse[0], b[5].out, b[5].out, r->g->nodes, n->side, b[5].out, r->par);
   dn__tap(r, "unpool", n->side, 0, r->g->nodes, b[5].out, b[5].out);
   dn__run_block(r, &b[6], r->g, n->side, b[5].out, n->wide + local, stride); /* T 3.13 */
   dn__run_tail(r, n->wide, stride, y);
}
/* mlp, gat, neuroskinning: one block after the other */
static void dn__run_chain(const dn__run *r, const float *rows, float *y)
{
   const dn__block *b = r->m->blocks;
   const float *x = rows;
   size_t i, stride = r->m->info.row_width, last = r->m->block_count - 1;
   for (i = 0; i < last; i++) {
      float *out = i % 2 ? r->n->side : r->n->wide;
      dn__run_block(r, &b[i], r->g, x, stride, out, b[i].out);
      x = out;
      stride = b[i].out;
   }
   dn__run_block(r, &b[last], r->g, x, stride, y, 3);
}
static void dn__run_network(const dn__run *r, const float *rows, float *y)
{
   if (r->m->info.arch == DN_DENSEGATS) dn__run_densegats(r, rows, y);
   else if (r->m->info.arch == DN_MULTIRESGNET) dn__run_multiresgnet(r, rows, y);
   else dn__run_chain(r, rows, y);
}

/* ===================================================================================== >>rig
   in       a model, a mesh with skin and skeleton as the engine holds them      out   dn_rig, dn_report
   touches  the rig's memory and scratch; the mesh is only read, and only here
   flow     check and copy -> weld -> one-rings -> (now all sizes are exact) -> joints by name -> geodesic
            distances -> rest-pose clusters of "rest" pooling
   read     dn__bind_prepare, then dn__bind_finish */

struct dn_rig {
   const dn_model *model;         /* NULL: skins only */
   dn_rig_view view;
   dn_skinning skinning;
   dn_allocator allocator;
   const dn_allocator *allocator_used; /* NULL: DN_MALLOC, or &allocator */
   int owned;
   size_t bytes;
   uint32_t root;                 /* the character's joint that is the model's joint 0 */
   const uint32_t *fold;          /* (S) joint that the network sees in place of joint s, or NULL: itself */
   const uint32_t *corner_first, *corner_tri; /* triangles at each node, for the normals */
   const float *rest_vertices;    /* (V,3): with a weld distance, vertices of a node rest apart */
   int has_clusters;              /* rest pooling */
   dn_clusters clusters;
};

typedef struct dn__bind { /* bind's scratch: the mesh in the library's own form */
   const dn_model *model;
   const dn_rig_desc *desc;
   dn_error *err;
   dn_report report;
   size_t vertices, triangles, kept, joints, model_joints, influences, nodes, neighbours;
   int wants_geodesic, wants_clusters;
   float *positions;              /* (V,3) */
   uint32_t *joint;               /* (V,I) */
   float *weight;                 /* (V,I) */
   uint32_t *node_of_vertex;      /* (V) */
   uint32_t *first_vertex;        /* (V), N used */
   uint32_t *triangle;            /* (T,3) node indices; the first `kept` have three different nodes once welded */
   uint32_t *first, *next;        /* one-rings */
   void *work;                    /* scratch of one step at a time */
   size_t work_bytes;
} dn__bind;

#define DN__MOST ((size_t)0x7fffffff / 8) /* vertices, triangles: 6 per triangle and 3 per vertex stay 32-bit indices */
static const char dn__where_bind[] = "bind";
static dn_result dn__bind_fail(const dn__bind *b, dn_result code, const char *what, size_t index, const char *problem)
{
   return dn__fail_sizes(b->err, code, dn__where_bind, index, what, index, NULL, 0, problem);
}
/* "triangle 7: vertex index 99, expected below 42" */
static dn_result dn__bind_range(const dn__bind *b, dn_result code, const char *what, size_t at, const char *found, size_t value, size_t limit)
{
   char line[240];
   dn__text t = dn__text_of(line, sizeof line);
   dn__put(&t, what);
   dn__put_size(&t, at);
   dn__put(&t, found);
   dn__put_size(&t, value);
   dn__put(&t, ", expected below ");
   dn__put_size(&t, limit);
   return dn__fail(b->err, code, dn__where_bind, at, line);
}
static int dn__step(const dn__bind *b, const char *stage, float done) /* non-zero: cancelled */
{
   const dn_progress *p = b->desc->progress;
   return p && p->step && p->step(p->user, stage, done);
}
static dn_result dn__cancelled(const dn__bind *b) { return dn__fail(b->err, DN_CANCELLED, dn__where_bind, SIZE_MAX, "cancelled by the progress callback"); }

/* --- the caller's arrays, whatever their type and stride */
static size_t dn__type_size(dn_type t) { return t == DN_U8 || t == DN_U8N ? 1 : t == DN_U16 || t == DN_U16N ? 2 : 4; }
static size_t dn__index_at(const void *data, dn_type type, size_t at_byte)
{
   const unsigned char *p = (const unsigned char *)data + at_byte;
   uint16_t h;
   uint32_t w;
   if (type == DN_U8) return *p;
   if (type == DN_U16) return memcpy(&h, p, 2), (size_t)h;
   return memcpy(&w, p, 4), (size_t)w;
}
static float dn__weight_at(const void *data, dn_type type, size_t at_byte)
{
   const unsigned char *p = (const unsigned char *)data + at_byte;
   uint16_t h;
   float f;
   if (type == DN_U8N) return (float)*p / 255.0f;
   if (type == DN_U16N) return memcpy(&h, p, 2), (float)h / 65535.0f;
   return memcpy(&f, p, 4), f;
}
static size_t dn__stride(size_t given, size_t packed) { return given ? given : packed; }
/* calls are per vertex and set: weight k of vertex v */
static float dn__set_weight(const dn_skin_set *s, size_t v, size_t k)
{
   size_t size = dn__type_size(s->weight_type);
   return dn__weight_at(s->weights, s->weight_type, v * dn__stride(s->weight_stride, s->influences * size) + k * size);
}
static size_t dn__set_joint(const dn_skin_set *s, size_t v, size_t k)
{
   size_t size = dn__type_size(s->joint_type);
   return dn__index_at(s->joints, s->joint_type, v * dn__stride(s->joint_stride, s->influences * size) + k * size);
}
static void dn__position_at(const dn_mesh *m, size_t v, float p[3])
{
   memcpy(p, (const unsigned char *)m->positions + v * dn__stride(m->position_stride, 12), 12);
}

/* What the caller must get right is asserted; what may come from a file is checked in the steps below. */
static dn_result dn__bind_open(dn__bind *b, const dn_model *model, const dn_rig_desc *desc, dn_error *err)
{
   const dn_mesh *m = &desc->mesh;
   size_t v, s, k, i;
   memset(b, 0, sizeof *b);
   b->model = model;
   b->desc = desc;
   b->err = err;
   b->vertices = m->vertices;
   b->triangles = m->triangles;
   b->joints = desc->skeleton.joints;
   if (m->vertices == 0) return dn__fail(err, DN_BAD_MESH, dn__where_bind, SIZE_MAX, "no vertices");
   if (b->joints == 0 || m->skin_sets == 0) return dn__fail(err, DN_BAD_SKIN, dn__where_bind, SIZE_MAX, "no joints or no skin weights: the mesh is not skinned");
   if (m->vertices > DN__MOST || m->triangles > DN__MOST)
      return dn__fail_sizes(err, DN_BAD_MESH, dn__where_bind, SIZE_MAX, m->vertices > DN__MOST ? "vertices: found " : "triangles: found ",
                            m->vertices > DN__MOST ? m->vertices : m->triangles, ", expected at most ", DN__MOST, NULL);
   if (b->joints > DN_MAX_DIM) return dn__fail_sizes(err, DN_BAD_SKIN, dn__where_bind, SIZE_MAX, "joints: found ", b->joints, ", expected at most ", DN_MAX_DIM, NULL);
   DN_ASSERT(m->positions && m->skin && (m->triangles == 0 || m->indices));
   DN_ASSERT(m->triangles == 0 || m->index_type == DN_U16 || m->index_type == DN_U32);
   for (s = 0; s < m->skin_sets; s++) {
      if (m->skin[s].influences == 0) continue;
      DN_ASSERT(m->skin[s].joints && m->skin[s].weights);
      DN_ASSERT(m->skin[s].joint_type == DN_U8 || m->skin[s].joint_type == DN_U16 || m->skin[s].joint_type == DN_U32);
      DN_ASSERT(m->skin[s].weight_type == DN_F32 || m->skin[s].weight_type == DN_U8N || m->skin[s].weight_type == DN_U16N);
   }
   if (desc->resolution > 512) return dn__fail_sizes(err, DN_BAD_VALUE, dn__where_bind, SIZE_MAX, "resolution ", desc->resolution, ", at most ", 512, NULL);
   if (!dn__finite(desc->weld_distance)) return dn__fail(err, DN_BAD_VALUE, dn__where_bind, SIZE_MAX, "weld_distance is not finite");
   for (v = 0; v < m->vertices; v++) { /* how many influences are really used */
      for (i = 0, s = 0; s < m->skin_sets; s++)
         for (k = 0; k < m->skin[s].influences; k++) {
            float w = dn__set_weight(&m->skin[s], v, k);
            if (!dn__finite(w)) return dn__bind_fail(b, DN_BAD_SKIN, "vertex ", v, ": a skin weight is not finite");
            i += w > 0.0f;
         }
      b->influences = dn__max(b->influences, i);
   }
   b->influences = dn__max(b->influences, 1);
   if (model) {
      for (i = 0; i < model->info.feature_count; i++) b->wants_geodesic |= model->features[i] == DN_GEODESIC;
      b->wants_clusters = model->info.arch == DN_MULTIRESGNET && model->info.pooling == DN_POOL_REST;
      b->model_joints = model->info.joints;
   }
   return DN_OK;
}
static unsigned dn__resolution(const dn_rig_desc *d) { return d->resolution ? d->resolution : 128; }

/* --- layouts: one for scratch (from the counts and the bounding box), one for the rig (bounds, or exact once welded) */
static size_t dn__frame_bytes(const dn_model *m, size_t vertices, size_t nodes, size_t neighbours, size_t joints,
                              const dn_clusters *rest, int dual, unsigned workers);
/* dn_geodesic_scratch before there are nodes: what it needs depends on the bounding box only. Welding over a distance
   moves each face of the box in by at most that much; where the longest side shrinks, the cells do, and the other sides
   take more of them. */
static size_t dn__geodesic_scratch_box(float box[6], size_t nodes, float weld_distance, unsigned resolution, unsigned workers)
{
   size_t corners;
   double side[3], longest = 0.0, least;
   int k;
   for (k = 0; k < 3; k++) {
      side[k] = (double)box[3 + k] - (double)box[k];
      longest = side[k] > longest ? side[k] : longest;
   }
   if (weld_distance > 0.0f && longest > 0.0) {
      least = longest - 2.0 * (double)weld_distance;
      for (k = 0; k < 3; k++) { /* the box in longest sides: only ratios count; a thousandth more covers the rounding */
         double ratio = least > 0.0 ? 1.001 * side[k] / least : 1.0;
         box[k] = 0.0f;
         box[3 + k] = ratio < 1.0 && side[k] < longest ? (float)ratio : 1.0f;
      }
   }
   corners = dn_geodesic_scratch(box, 2, 0, resolution, workers);
   return dn__add(corners, dn__round(dn__mul(nodes, sizeof(uint32_t)), DN__ALIGN)); /* a cell per node */
}
static void dn__bind_memory(dn__bind *b, dn__arena *a)
{
   size_t V = b->vertices, T = b->triangles, neighbours = dn__mul(T, 6), work, i;
   unsigned workers = dn__workers(b->desc->parallel);
   b->positions = (float *)dn__take(a, dn__mul(V, 3), sizeof(float));
   b->joint = (uint32_t *)dn__take(a, dn__mul(V, b->influences), sizeof(uint32_t));
   b->weight = (float *)dn__take(a, dn__mul(V, b->influences), sizeof(float));
   b->node_of_vertex = (uint32_t *)dn__take(a, V, sizeof(uint32_t));
   b->first_vertex = (uint32_t *)dn__take(a, V, sizeof(uint32_t));
   b->triangle = (uint32_t *)dn__take(a, dn__mul(T, 3), sizeof(uint32_t));
   b->first = (uint32_t *)dn__take(a, dn__add(V, 1), sizeof(uint32_t));
   b->next = (uint32_t *)dn__take(a, neighbours, sizeof(uint32_t));
   work = dn__max(dn_weld_scratch(V), dn_graph_scratch(V, T));
   work = dn__max(work, dn__mul(V, 2 * sizeof(uint32_t)));
   if (b->wants_geodesic && !b->desc->geodesic) {
      float box[6]; /* two opposite corners */
      dn__position_at(&b->desc->mesh, 0, box);
      memcpy(box + 3, box, 3 * sizeof *box);
      for (i = 1; i < V; i++) {
         float p[3];
         int c;
         dn__position_at(&b->desc->mesh, i, p);
         for (c = 0; c < 3; c++) {
            if (p[c] < box[c]) box[c] = p[c];
            if (p[c] > box[3 + c]) box[3 + c] = p[c];
         }
      }
      work = dn__max(work, dn__geodesic_scratch_box(box, V, b->desc->weld_distance, dn__resolution(b->desc), workers));
   }
   if (b->wants_clusters) /* the network up to its pool, on the rest pose */
      work = dn__max(work, dn__add(dn__mul(b->joints, 12 * sizeof(float) + DN__ALIGN), dn__frame_bytes(b->model, V, V, neighbours, b->joints, NULL, b->desc->skinning == DN_DQS, workers)));
   b->work_bytes = work;
   b->work = dn__take(a, work, 1);
}
static void dn__rig_layout(dn_rig *r, const dn__bind *b, size_t nodes, size_t neighbours, size_t kept, dn__arena *a)
{
   dn_rig_view *v = &r->view;
   size_t V = b->vertices, I = b->influences;
   v->node_of_vertex = (uint32_t *)dn__take(a, V, sizeof(uint32_t));
   v->first_vertex = (uint32_t *)dn__take(a, nodes, sizeof(uint32_t));
   v->rest = (float *)dn__take(a, dn__mul(nodes, 3), sizeof(float));
   v->skin_joint = (uint32_t *)dn__take(a, dn__mul(V, I), sizeof(uint32_t));
   v->skin_weight = (float *)dn__take(a, dn__mul(V, I), sizeof(float));
   v->triangle = (uint32_t *)dn__take(a, dn__mul(kept, 3), sizeof(uint32_t));
   v->graph.first = (uint32_t *)dn__take(a, dn__add(nodes, 1), sizeof(uint32_t));
   v->graph.next = (uint32_t *)dn__take(a, neighbours, sizeof(uint32_t));
   v->joint_rest = (float *)dn__take(a, dn__mul(b->model_joints, 3), sizeof(float));
   v->joint_map = (uint32_t *)dn__take(a, b->model_joints, sizeof(uint32_t));
   v->geodesic = b->wants_geodesic ? (float *)dn__take(a, dn__mul(nodes, b->model_joints), sizeof(float)) : NULL;
   r->fold = (uint32_t *)dn__take(a, b->joints, sizeof(uint32_t));
   r->corner_first = (uint32_t *)dn__take(a, dn__add(nodes, 1), sizeof(uint32_t));
   r->corner_tri = (uint32_t *)dn__take(a, dn__mul(kept, 3), sizeof(uint32_t));
   r->rest_vertices = (float *)dn__take(a, dn__mul(V, 3), sizeof(float));
   if (b->wants_clusters) {
      dn__clusters_layout(&r->clusters, nodes, neighbours, a);
      r->clusters.score = (float *)dn__take(a, nodes, sizeof(float));
   }
}

/* --- step 1: check, copy, weld, connect */
static dn_result dn__bind_skin(dn__bind *b)
{
   const dn_mesh *m = &b->desc->mesh;
   size_t v, s, k;
   for (v = 0; v < b->vertices; v++) {
      uint32_t *joint = b->joint + v * b->influences;
      float *weight = b->weight + v * b->influences;
      size_t n = 0;
      double sum = 0.0;
      memset(joint, 0, b->influences * sizeof *joint);
      memset(weight, 0, b->influences * sizeof *weight);
      dn__position_at(m, v, b->positions + 3 * v);
      for (k = 0; k < 3; k++)
         if (!dn__finite(b->positions[3 * v + k])) return dn__bind_fail(b, DN_BAD_MESH, "vertex ", v, ": its position is not finite");
      for (s = 0; s < m->skin_sets; s++)
         for (k = 0; k < m->skin[s].influences; k++) {
            float w = dn__set_weight(&m->skin[s], v, k);
            size_t j = dn__set_joint(&m->skin[s], v, k);
            if (w < 0.0f) b->report.influences_dropped++;
            if (!(w > 0.0f)) continue;
            if (j >= b->joints) return dn__bind_range(b, DN_BAD_SKIN, "vertex ", v, ": joint index ", j, b->joints);
            joint[n] = (uint32_t)j;
            weight[n++] = w;
            sum += (double)w;
         }
      for (k = n; k < b->influences; k++) joint[k] = joint[0]; /* unused: 0 times a strange joint's NaN would be NaN */
      if (n == 0) {
         weight[0] = 1.0f; /* on joint 0 */
         b->report.weightless_vertices++;
      } else if (sum != 1.0) { /* sums off by rounding are made exact too, but only real ones are counted */
         if (!(DN_FABS(sum - 1.0) <= 1e-3)) b->report.weights_normalised++;
         if (!(DN_FABS(sum - 1.0) <= 1e-6))
            for (k = 0; k < n; k++) weight[k] = (float)((double)weight[k] / sum);
      }
   }
   return DN_OK;
}
static dn_result dn__bind_triangles(dn__bind *b)
{
   const dn_mesh *m = &b->desc->mesh;
   size_t t, c, size = dn__type_size(m->index_type);
   for (t = 0; t < b->triangles; t++)
      for (c = 0; c < 3; c++) {
         size_t v = dn__index_at(m->indices, m->index_type, (3 * t + c) * size);
         if (v >= b->vertices) return dn__bind_range(b, DN_BAD_MESH, "triangle ", t, ": vertex index ", v, b->vertices);
         b->triangle[3 * t + c] = b->node_of_vertex[v];
      }
   return DN_OK;
}
static void dn__bind_drop_degenerate(dn__bind *b) /* after the graph has their proper edges */
{
   size_t t;
   b->kept = 0;
   for (t = 0; t < b->triangles; t++) {
      uint32_t *q = b->triangle + 3 * t, *to = b->triangle + 3 * b->kept;
      const float *x = b->positions + 3 * (size_t)b->first_vertex[q[0]], *y = b->positions + 3 * (size_t)b->first_vertex[q[1]];
      const float *z = b->positions + 3 * (size_t)b->first_vertex[q[2]];
      double u[3], w[3];
      int c, flat;
      if (q[0] == q[1] || q[1] == q[2] || q[2] == q[0]) {
         b->report.degenerate_triangles++;
         continue;
      }
      for (c = 0; c < 3; c++) u[c] = (double)y[c] - (double)x[c], w[c] = (double)z[c] - (double)x[c];
      flat = u[1] * w[2] == u[2] * w[1] && u[2] * w[0] == u[0] * w[2] && u[0] * w[1] == u[1] * w[0];
      b->report.degenerate_triangles += (size_t)flat; /* flat at rest but not when posed: kept */
      memmove(to, q, 3 * sizeof *to);
      b->kept++;
   }
}
static dn_result dn__bind_prepare(dn__bind *b)
{
   dn_graph g;
   dn_result r;
   if (dn__step(b, "weld", 0.0f)) return dn__cancelled(b);
   if ((r = dn__bind_skin(b)) != DN_OK) return r;
   b->nodes = dn_weld(b->positions, b->vertices, b->joint, b->weight, b->influences, b->desc->weld_distance, b->node_of_vertex,
                      b->first_vertex, &b->report.seams_apart, b->work);
   if ((r = dn__bind_triangles(b)) != DN_OK) return r;
   if (dn__step(b, "graph", 0.0f)) return dn__cancelled(b);
   dn_graph_build(b->triangle, b->triangles, b->nodes, b->first, b->next, &g, b->work);
   b->neighbours = b->first[b->nodes];
   dn__bind_drop_degenerate(b);
   b->report.vertices = b->vertices;
   b->report.nodes = b->nodes;
   b->report.edges = b->neighbours / 2;
   b->report.influences = b->influences;
   b->report.seams_welded = b->vertices - b->nodes;
   b->report.isolated_nodes = dn__isolated_nodes(&g);
   b->report.components = dn__graph_components(&g, (uint32_t *)b->work, (uint32_t *)b->work + b->nodes);
   return DN_OK;
}

/* --- step 2: the model's joints in this skeleton */
static dn_result dn__bind_missing(dn__bind *b, const uint32_t *map)
{
   char line[240];
   dn__text t = dn__text_of(line, sizeof line);
   size_t s, missing = 0;
   for (s = 0; s < b->model_joints; s++) missing += map[s] == DN__NONE;
   dn__put(&t, "the skeleton lacks ");
   dn__put_size(&t, missing);
   dn__put(&t, " of the model's ");
   dn__put_size(&t, b->model_joints);
   dn__put(&t, " joints:");
   for (s = 0; s < b->model_joints; s++)
      if (map[s] == DN__NONE) dn__put(&t, " "), dn__put(&t, b->model->info.joint_names[s]);
   if (t.at == t.end) memcpy(t.end - 4, " ...", 4); /* the list did not fit; the count stands in front */
   return dn__fail(b->err, DN_MISSING_JOINT, dn__where_bind, SIZE_MAX, line);
}
static dn_result dn__bind_joints(dn__bind *b, uint32_t *map, uint32_t *fold)
{
   const dn_skeleton *sk = &b->desc->skeleton;
   const char *const *want = b->model ? b->model->info.joint_names : NULL;
   size_t s, k;
   for (k = 0; k < b->joints; k++) fold[k] = (uint32_t)k;
   if (!want) { /* by index */
      if (b->model_joints && b->model_joints != b->joints)
         return dn__fail_sizes(b->err, DN_MISSING_JOINT, dn__where_bind, SIZE_MAX, "the skeleton has ", b->joints, " joints, the model ", b->model_joints, " and no names");
      for (s = 0; s < b->model_joints; s++) map[s] = (uint32_t)s;
      b->report.joints_matched = b->model_joints;
      return DN_OK;
   }
   if (!sk->names) return dn__fail(b->err, DN_MISSING_JOINT, dn__where_bind, SIZE_MAX, "the model names its joints, the skeleton has no names");
   for (k = 0; k < b->joints; k++) fold[k] = DN__NONE;
   for (s = 0; s < b->model_joints; s++) {
      map[s] = DN__NONE;
      for (k = 0; k < b->joints && map[s] == DN__NONE; k++)
         if (fold[k] == DN__NONE && sk->names[k] && dn__name_equal(dn__name_core(sk->names[k]), dn__name_core(want[s]))) map[s] = fold[k] = (uint32_t)k;
      b->report.joints_matched += map[s] != DN__NONE;
   }
   if (b->report.joints_matched < b->model_joints) return dn__bind_missing(b, map);
   for (k = 0; k < b->joints; k++) {
      size_t at = k, hops; /* hops: a loop in the parents must not hang us */
      if (fold[k] == (uint32_t)k) continue;
      for (hops = 0; hops < b->joints && sk->parents && sk->parents[at] >= 0 && fold[at] == DN__NONE; hops++) {
         if ((size_t)sk->parents[at] >= b->joints)
            return dn__bind_range(b, DN_BAD_SKIN, "joint ", at, ": parent ", (size_t)sk->parents[at], b->joints);
         at = (size_t)sk->parents[at];
      }
      fold[k] = fold[at] != DN__NONE ? fold[at] : map[0]; /* a named joint's is itself, an extra one's was found already */
      b->report.joints_folded++;
   }
   return DN_OK;
}
/* where a joint is at rest: the point that its inverse bind takes to the origin */
static dn_result dn__bind_joint_rest(dn__bind *b, const uint32_t *map, float *rest)
{
   const dn_skeleton *sk = &b->desc->skeleton;
   size_t s, c, floats = dn__matrix_floats(sk->matrix);
   for (s = 0; s < b->model_joints; s++) {
      float m[12], t[3];
      memset(rest + 3 * s, 0, 3 * sizeof *rest);
      if (!sk->inverse_bind) continue;
      dn__load_matrix(sk->inverse_bind + floats * (size_t)map[s], sk->matrix, m);
      for (c = 0; c < 3; c++) t[c] = -m[4 * c + 3];
      if (!dn__finite12(m) || !dn__unskin(m, t, rest + 3 * s))
         return dn__bind_fail(b, DN_BAD_SKIN, "joint ", (size_t)map[s], ": its inverse bind matrix cannot be inverted");
   }
   return DN_OK;
}

/* --- step 3: what depends on the model */
static dn_result dn__bind_geodesic(dn__bind *b, const dn_rig *r, float *geodesic)
{
   dn_result result;
   if (b->desc->geodesic) {
      size_t i, n = b->nodes * b->model_joints;
      if (b->desc->geodesic_nodes != b->nodes)
         return dn__fail_sizes(b->err, DN_BAD_SHAPE, dn__where_bind, SIZE_MAX, "geodesic: ", b->desc->geodesic_nodes, " nodes given, the mesh has ", b->nodes, NULL);
      for (i = 0; i < n; i++)
         if (!dn__finite(b->desc->geodesic[i])) return dn__bind_fail(b, DN_BAD_VALUE, "geodesic: node ", i / b->model_joints, " has a distance that is not finite");
      memcpy(geodesic, b->desc->geodesic, n * sizeof *geodesic);
      return DN_OK;
   }
   result = dn_geodesic(r->view.rest, b->nodes, r->view.triangle, b->kept, r->view.joint_rest, b->model_joints, dn__resolution(b->desc), geodesic,
                        &b->report.solid_cells, &b->report.cell, b->work, b->work_bytes, b->desc->parallel, b->desc->progress);
   return result == DN_OK ? DN_OK : result == DN_CANCELLED ? dn__cancelled(b) : dn__fail(b->err, result, dn__where_bind, SIZE_MAX, "geodesic distances");
}
static dn_result dn__bind_clusters(dn__bind *b, dn_rig *r);

static dn_result dn__bind_finish(dn__bind *b, dn_rig *r)
{
   dn_rig_view *v = &r->view;
   size_t i, V = b->vertices, N = b->nodes, I = b->influences;
   uint32_t *map = (uint32_t *)v->joint_map, *fold = (uint32_t *)r->fold;
   dn_result result;
   r->model = b->model;
   r->skinning = b->desc->skinning;
   v->vertices = V;
   v->nodes = v->graph.nodes = N;
   v->joints = b->joints;
   v->influences = I;
   v->triangles = b->kept;
   memcpy((uint32_t *)v->node_of_vertex, b->node_of_vertex, V * sizeof(uint32_t));
   memcpy((uint32_t *)v->first_vertex, b->first_vertex, N * sizeof(uint32_t));
   memcpy((uint32_t *)v->skin_joint, b->joint, V * I * sizeof(uint32_t));
   memcpy((float *)v->skin_weight, b->weight, V * I * sizeof(float));
   memcpy((float *)r->rest_vertices, b->positions, 3 * V * sizeof(float));
   memcpy((uint32_t *)v->triangle, b->triangle, 3 * b->kept * sizeof(uint32_t));
   memcpy((uint32_t *)v->graph.first, b->first, (N + 1) * sizeof(uint32_t));
   memcpy((uint32_t *)v->graph.next, b->next, b->neighbours * sizeof(uint32_t));
   for (i = 0; i < N; i++) memcpy((float *)v->rest + 3 * i, b->positions + 3 * (size_t)b->first_vertex[i], 3 * sizeof(float));
   dn__corners_build(v->triangle, b->kept, N, (uint32_t *)r->corner_first, (uint32_t *)r->corner_tri);
   if ((result = dn__bind_joints(b, map, fold)) != DN_OK) return result;
   if ((result = dn__bind_joint_rest(b, map, (float *)v->joint_rest)) != DN_OK) return result;
   r->root = b->model_joints ? map[0] : 0;
   if (b->report.joints_folded == 0) r->fold = NULL;
   if (b->wants_geodesic && (result = dn__bind_geodesic(b, r, (float *)v->geodesic)) != DN_OK) return result;
   if (b->wants_clusters && (result = dn__bind_clusters(b, r)) != DN_OK) return result;
   dn__step(b, "done", 1.0f);
   return DN_OK;
}

DN_API dn_result dn_rig_size(const dn_model *model, const dn_rig_desc *desc, size_t *bytes, size_t *scratch, dn_error *err)
{
   dn__bind b;
   dn__arena kept = dn__arena_of(NULL, 0), temp = dn__arena_of(NULL, 0);
   dn_rig measure;
   dn_result r;
   DN_ASSERT(desc && bytes && scratch);
   if ((r = dn__bind_open(&b, model, desc, err)) != DN_OK) return r;
   dn__take(&kept, 1, sizeof(dn_rig));
   dn__rig_layout(&measure, &b, b.vertices, dn__mul(b.triangles, 6), b.triangles, &kept);
   dn__bind_memory(&b, &temp);
   *bytes = kept.used;
   *scratch = temp.used;
   return *bytes == SIZE_MAX || *scratch == SIZE_MAX ? dn__fail(err, DN_NO_MEMORY, dn__where_bind, SIZE_MAX, "sizes overflow") : DN_OK;
}
/* a prepared bind into memory of exactly the right size */
static dn_result dn__rig_build(dn__bind *b, void *memory, size_t bytes, dn_rig **rig)
{
   dn__arena kept = dn__arena_of(memory, bytes);
   dn_rig *r = (dn_rig *)dn__take(&kept, 1, sizeof(dn_rig));
   dn_result result;
   if (!r) return dn__fail_sizes(b->err, DN_TOO_SMALL, dn__where_bind, SIZE_MAX, "memory: ", bytes, " bytes given, too small", 0, NULL);
   memset(r, 0, sizeof *r);
   dn__rig_layout(r, b, b->nodes, b->neighbours, b->kept, &kept);
   if (kept.used > bytes) return dn__fail_sizes(b->err, DN_TOO_SMALL, dn__where_bind, SIZE_MAX, "memory: ", bytes, " bytes given, needed ", kept.used, NULL);
   r->bytes = kept.used;
   if ((result = dn__bind_finish(b, r)) != DN_OK) return result;
   r->view.bytes = r->bytes;
   *rig = r;
   return DN_OK;
}
static dn_result dn__bind_start(dn__bind *b, const dn_model *model, const dn_rig_desc *desc, void *scratch, size_t scratch_bytes, dn_error *err)
{
   dn__arena temp = dn__arena_of(scratch, scratch_bytes);
   dn_result r = dn__bind_open(b, model, desc, err);
   if (r != DN_OK) return r;
   dn__bind_memory(b, &temp);
   if (temp.used > scratch_bytes) return dn__fail_sizes(err, DN_TOO_SMALL, dn__where_bind, SIZE_MAX, "scratch: ", scratch_bytes, " bytes given, needed ", temp.used, NULL);
   return dn__bind_prepare(b);
}
DN_API dn_result dn_rig_init(const dn_model *model, const dn_rig_desc *desc, void *memory, size_t bytes, void *scratch,
                             size_t scratch_bytes, dn_rig **rig, dn_report *report, dn_error *err)
{
   dn__bind b;
   dn_result r;
   DN_ASSERT(desc && memory && scratch && rig && ((uintptr_t)memory & 63) == 0 && ((uintptr_t)scratch & 63) == 0);
   *rig = NULL;
   r = dn__bind_start(&b, model, desc, scratch, scratch_bytes, err);
   if (r == DN_OK) r = dn__rig_build(&b, memory, bytes, rig);
   if (r == DN_OK && report) *report = b.report;
   return r;
}
DN_API dn_rig *dn_rig_create(const dn_model *model, const dn_rig_desc *desc, const dn_allocator *allocator, dn_report *report,
                             dn_error *err)
{
   dn__bind b;
   dn_rig *rig = NULL;
   size_t bytes = 0, scratch_bytes = 0;
   void *scratch, *memory = NULL;
   if (dn_rig_size(model, desc, &bytes, &scratch_bytes, err) != DN_OK) return NULL;
   scratch = dn__alloc(allocator, scratch_bytes);
   if (!scratch) {
      dn__fail_sizes(err, DN_NO_MEMORY, dn__where_bind, SIZE_MAX, "bind scratch of ", scratch_bytes, NULL, 0, " bytes");
      return NULL;
   }
   if (dn__bind_start(&b, model, desc, scratch, scratch_bytes, err) == DN_OK) { /* welded: the rig's size is exact now */
      dn__arena kept = dn__arena_of(NULL, 0);
      dn_rig measure;
      dn__take(&kept, 1, sizeof(dn_rig));
      dn__rig_layout(&measure, &b, b.nodes, b.neighbours, b.kept, &kept);
      bytes = kept.used;
      memory = dn__alloc(allocator, bytes);
      if (!memory) dn__fail_sizes(err, DN_NO_MEMORY, dn__where_bind, SIZE_MAX, "rig of ", bytes, NULL, 0, " bytes");
      else if (dn__rig_build(&b, memory, bytes, &rig) != DN_OK) dn__release(allocator, memory, bytes);
   }
   dn__release(allocator, scratch, scratch_bytes);
   if (rig) {
      rig->owned = 1;
      if (allocator) rig->allocator = *allocator, rig->allocator_used = &rig->allocator;
      if (report) *report = b.report;
   }
   return rig;
}
DN_API void dn_rig_free(dn_rig *rig)
{
   if (rig && rig->owned) {
      dn_allocator a = rig->allocator; /* the copy inside goes with the memory */
      dn__release(rig->allocator_used ? &a : NULL, rig, rig->bytes);
   }
}
DN_API void dn_rig_describe(const dn_rig *rig, dn_rig_view *view) { *view = rig->view; }

/* ===================================================================================== >>frame
   in       a rig, a pose, scratch                            out   positions, normals, displacements (V,3)
   touches  the scratch and the caller's output arrays: no allocation, no I/O, no statics
   flow     dn_stage_skin -> dn_stage_rows -> dn_stage_network -> dn_stage_output; dn_deform is the four in a row
   paper    T 2.1, T 2.2 (skinning), T 3.9 (relative), spec sections 2 and 3 */

typedef struct dn__frame {    /* the scratch, carved the same way by every stage */
   float *palette;            /* (S,12) model space */
   float *seen;               /* (S,12) what the network sees: root frame, extra joints folded */
   float *dual;               /* (S,8) dual quaternions of palette, DQS only */
   float *posed;              /* (S_model,3) joints, in the network's frame */
   float *root;               /* (9) rotation of the network's frame, identity for "model" */
   float *skinned;            /* (V,3) model space */
   float *coarse;             /* (N,3) model space */
   float *framed;             /* (N,3) coarse in the network's frame */
   float *low;                /* (N,3) what float leaves of framed; only the normals need it */
   float *normals;            /* (N,3) of framed; later of the refined mesh */
   float *rows;               /* (N,D) */
   float *displacement;       /* (N,3) network's frame, then model space */
   uint32_t *state;           /* (3) fallback nodes, finite palette, skinned by LBS here */
   dn__net net;
} dn__frame;

static void dn__frame_layout(dn__frame *f, const dn_model *m, size_t vertices, size_t nodes, size_t neighbours, size_t joints,
                             const dn_clusters *rest, int dual, unsigned workers, dn__arena *a)
{
   size_t width = m ? m->info.row_width : 0;
   memset(f, 0, sizeof *f);
   f->palette = (float *)dn__take(a, dn__mul(joints, 12), sizeof(float));
   f->seen = (float *)dn__take(a, dn__mul(joints, 12), sizeof(float));
   f->dual = dual ? (float *)dn__take(a, dn__mul(joints, 8), sizeof(float)) : NULL;
   f->posed = (float *)dn__take(a, dn__mul(m ? m->info.joints : 0, 3), sizeof(float));
   f->root = (float *)dn__take(a, 9, sizeof(float));
   f->skinned = (float *)dn__take(a, dn__mul(vertices, 3), sizeof(float));
   f->coarse = (float *)dn__take(a, dn__mul(nodes, 3), sizeof(float));
   f->framed = (float *)dn__take(a, dn__mul(nodes, 3), sizeof(float));
   f->low = (float *)dn__take(a, dn__mul(m ? nodes : 0, 3), sizeof(float));
   f->normals = (float *)dn__take(a, dn__mul(nodes, 3), sizeof(float));
   f->displacement = (float *)dn__take(a, dn__mul(nodes, 3), sizeof(float));
   f->state = (uint32_t *)dn__take(a, 3, sizeof(uint32_t));
   f->rows = (float *)dn__take(a, dn__mul(nodes, width), sizeof(float));
   if (m) dn__net_layout(&f->net, m, nodes, neighbours, rest, workers, a);
}
static size_t dn__frame_bytes(const dn_model *m, size_t vertices, size_t nodes, size_t neighbours, size_t joints,
                              const dn_clusters *rest, int dual, unsigned workers)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn__frame f;
   dn__frame_layout(&f, m, vertices, nodes, neighbours, joints, rest, dual, workers, &a);
   return a.used;
}
static dn__frame dn__frame_of(const dn_rig *r, void *scratch, unsigned workers)
{
   dn__arena a = dn__arena_of(scratch, SIZE_MAX / 2);
   dn__frame f;
   dn__frame_layout(&f, r->model, r->view.vertices, r->view.nodes, r->view.graph.first[r->view.nodes], r->view.joints,
                    r->has_clusters ? &r->clusters : NULL, r->skinning == DN_DQS, workers, &a);
   return f;
}
DN_API size_t dn_scratch_size(const dn_rig *r, unsigned workers)
{
   return dn__frame_bytes(r->model, r->view.vertices, r->view.nodes, r->view.graph.first[r->view.nodes], r->view.joints,
                          r->has_clusters ? &r->clusters : NULL, r->skinning == DN_DQS, workers ? workers : 1);
}
DN_API void *dn_scratch_create(const dn_rig *r, unsigned workers, const dn_allocator *allocator, size_t *bytes, dn_error *err)
{
   void *scratch;
   DN_ASSERT(r && bytes);
   *bytes = dn_scratch_size(r, workers);
   scratch = dn__alloc(allocator, *bytes);
   if (!scratch) dn__fail_sizes(err, DN_NO_MEMORY, "frame", SIZE_MAX, "scratch of ", *bytes, NULL, 0, " bytes");
   return scratch;
}
DN_API void dn_scratch_free(void *scratch, size_t bytes, const dn_allocator *allocator) { dn__release(allocator, scratch, bytes); }
static float *dn__strided(float *base, size_t stride, size_t i) { return (float *)((unsigned char *)base + i * stride); }

/* --- stage 1: skin */
typedef struct dn__skin_job { const dn_rig *r; const dn__frame *f; const dn_pose *pose; } dn__skin_job;
static void dn__skin_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__skin_job *j = (const dn__skin_job *)job;
   const dn_rig *r = j->r;
   size_t v;
   (void)worker;
   if (j->pose->skinned) {
      size_t stride = dn__stride(j->pose->skinned_stride, 12);
      for (v = begin; v < end; v++) memcpy(j->f->skinned + 3 * v, (const unsigned char *)j->pose->skinned + v * stride, 12);
   } else if (r->skinning == DN_DQS)
      dn__dqs_range(r->rest_vertices, r->view.skin_joint, r->view.skin_weight, r->view.influences, j->f->dual, begin, end, j->f->skinned);
   else dn__lbs_range(r->rest_vertices, r->view.skin_joint, r->view.skin_weight, r->view.influences, j->f->palette, begin, end, j->f->skinned);
}
DN_API dn_result dn_stage_skin(const dn_rig *rig, const dn_pose *pose, void *scratch, size_t scratch_bytes,
                               const dn_parallel *parallel, dn_error *err)
{
   dn__frame f;
   dn__skin_job job;
   size_t s, floats, need = dn_scratch_size(rig, dn__workers(parallel));
   DN_ASSERT(pose && pose->palette && scratch && ((uintptr_t)scratch & 63) == 0);
   if (scratch_bytes < need) return dn__fail_sizes(err, DN_TOO_SMALL, "frame", SIZE_MAX, "scratch: ", scratch_bytes, " bytes given, needed ", need, NULL);
   f = dn__frame_of(rig, scratch, dn__workers(parallel));
   floats = dn__matrix_floats(pose->matrix);
   f.state[0] = 0;
   f.state[1] = 1;
   f.state[2] = !pose->skinned && rig->skinning == DN_LBS;
   for (s = 0; s < rig->view.joints; s++) {
      dn__load_matrix(pose->palette + floats * s, pose->matrix, f.palette + 12 * s);
      f.state[1] &= (uint32_t)dn__finite12(f.palette + 12 * s);
   }
   if (rig->skinning == DN_DQS) dn__dual_quaternions(f.palette, rig->view.joints, f.dual);
   job.r = rig;
   job.f = &f;
   job.pose = pose;
   dn__for(parallel, rig->view.vertices, 1024, dn__skin_range, &job);
   return DN_OK;
}

/* --- stage 2: what the network reads */
typedef struct dn__rows_job { const dn_rig *r; const dn__frame *f; } dn__rows_job;
static void dn__framed_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__rows_job *j = (const dn__rows_job *)job;
   const dn__frame *f = j->f;
   const dn_rig_view *view = &j->r->view;
   size_t i, k;
   (void)worker;
   for (i = begin; i < end; i++) {
      size_t v = view->first_vertex[i];
      double p[3];
      memcpy(f->coarse + 3 * i, f->skinned + 3 * v, 12);
      for (k = 0; k < 3; k++) p[k] = (double)f->coarse[3 * i + k];
      if (!j->r->model) continue;
      if (f->state[2]) /* the same sum again, not yet rounded */
         dn__lbs_point(view->skin_joint + view->influences * v, view->skin_weight + view->influences * v, view->influences,
                       f->palette, view->rest + 3 * i, p);
      for (k = 0; k < 3; k++) {
         const float *r = f->root + k;
         double x = (double)r[0] * p[0] + (double)r[3] * p[1] + (double)r[6] * p[2]; /* R^T p */
         f->framed[3 * i + k] = (float)x;
         f->low[3 * i + k] = (float)(x - (double)f->framed[3 * i + k]);
      }
   }
}
static void dn__rows_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__rows_job *j = (const dn__rows_job *)job;
   const dn_rig_view *v = &j->r->view;
   const dn__frame *f = j->f;
   const dn_model_info *m = &j->r->model->info;
   size_t k, D = m->row_width;
   float *rows = f->rows;
   (void)worker;
   dn__normals_fine_range(f->framed, f->low, v->triangle, j->r->corner_first, j->r->corner_tri, begin, end, f->normals);
   for (k = 0; k < m->feature_count; k++) {
      switch (m->features[k]) {
      case DN_POSITION: dn__rows_position(f->framed, begin, end, rows, D); rows += 3; break;
      case DN_RELATIVE:
         dn__rows_relative(v->rest, v->skin_joint, v->skin_weight, v->influences, v->first_vertex, f->seen, begin, end, rows, D);
         rows += 3;
         break;
      case DN_NORMAL: dn__rows_normal(f->normals, begin, end, rows, D); rows += 3; break;
      case DN_GEODESIC: dn__rows_geodesic(v->geodesic, m->joints, begin, end, rows, D); rows += m->joints; break;
      case DN_DISTANCE: dn__rows_distance(f->framed, f->posed, m->joints, begin, end, rows, D); rows += m->joints; break;
      default: break;
      }
   }
}
DN_API void dn_stage_rows(const dn_rig *rig, void *scratch, const dn_parallel *parallel)
{
   dn__frame f = dn__frame_of(rig, scratch, dn__workers(parallel));
   dn__rows_job job;
   size_t s;
   int k;
   for (k = 0; k < 9; k++) f.root[k] = k % 4 == 0 ? 1.0f : 0.0f;
   if (rig->model && rig->model->info.root_frame) dn__root_rotation(f.palette + 12 * (size_t)rig->root, f.root);
   job.r = rig;
   job.f = &f;
   dn__for(parallel, rig->view.nodes, 1024, dn__framed_range, &job);
   if (!rig->model) return;
   for (s = 0; s < rig->view.joints; s++)
      dn__root_palette(f.palette + 12 * (size_t)(rig->fold ? rig->fold[s] : (uint32_t)s), 1, f.root, f.seen + 12 * s);
   dn__posed_joints(f.seen, rig->view.joint_map, rig->view.joint_rest, rig->model->info.joints, f.posed);
   dn__for(parallel, rig->view.nodes, 512, dn__rows_range, &job);
}

/* --- stage 3: the network, and its output made displacements in model space */
static void dn__normalise_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__rows_job *j = (const dn__rows_job *)job;
   const dn_model *m = j->r->model;
   size_t i, k, D = m->info.row_width;
   (void)worker;
   for (i = begin; i < end; i++)
      for (k = 0; k < D; k++) j->f->rows[i * D + k] = (j->f->rows[i * D + k] - m->input_mean[k]) * m->input_scale[k];
}
static void dn__displace_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__rows_job *j = (const dn__rows_job *)job;
   const dn_model *m = j->r->model;
   size_t i, k;
   (void)worker;
   for (i = begin; i < end; i++) {
      float *d = j->f->displacement + 3 * i;
      for (k = 0; k < 3; k++) d[k] = d[k] * m->output_std[k] + m->output_mean[k];
      dn__rotate(j->f->root, d, d);
   }
}
DN_API void dn_stage_network(const dn_rig *rig, void *scratch, const dn_parallel *parallel, const dn_probe *probe)
{
   dn__frame f = dn__frame_of(rig, scratch, dn__workers(parallel));
   dn__rows_job job;
   dn__run run;
   size_t i, k, nodes = rig->view.nodes;
   if (!rig->model) {
      memset(f.displacement, 0, 3 * nodes * sizeof *f.displacement);
      return;
   }
   job.r = rig;
   job.f = &f;
   if (rig->model->input_mean) dn__for(parallel, nodes, 512, dn__normalise_range, &job);
   run.m = rig->model;
   run.g = &rig->view.graph;
   run.n = &f.net;
   run.par = parallel;
   run.probe = probe;
   dn__run_network(&run, f.rows, f.displacement);
   dn__for(parallel, nodes, 1024, dn__displace_range, &job);
   for (i = 0; i < nodes; i++) { /* the worst case is always the skinned mesh */
      float *d = f.displacement + 3 * i;
      int good = 1;
      for (k = 0; k < 3; k++) good &= dn__finite(d[k]) & dn__finite(f.coarse[3 * i + k]);
      if (good) continue;
      f.state[0]++;
      d[0] = d[1] = d[2] = 0.0f;
   }
}

/* --- stage 4: out to the caller */
typedef struct dn__output_job { const dn_rig *r; const dn__frame *f; const dn_pose *pose; dn_output *out; float strength; } dn__output_job;
static float dn__unit_clamp(float x) { return x > 1.0f ? 1.0f : x > 0.0f ? x : 0.0f; } /* NaN: 0 */
static float dn__amount(const dn__output_job *j, size_t v)
{
   return j->pose->mask ? j->strength * dn__unit_clamp(j->pose->mask[v]) : j->strength;
}
static void dn__output_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__output_job *j = (const dn__output_job *)job;
   const dn_rig_view *view = &j->r->view;
   dn_output *o = j->out;
   size_t v, k;
   (void)worker;
   for (v = begin; v < end; v++) {
      const float *d = j->f->displacement + 3 * (size_t)view->node_of_vertex[v];
      float amount = dn__amount(j, v), shift[3], *p = j->f->skinned + 3 * v; /* refined in place for the bounds */
      for (k = 0; k < 3; k++) {
         shift[k] = amount * d[k];
         p[k] += shift[k];
      }
      if (o->positions) memcpy(dn__strided(o->positions, dn__stride(o->position_stride, 12), v), p, 12);
      if (o->displacement) memcpy(dn__strided(o->displacement, dn__stride(o->displacement_stride, 12), v), shift, 12);
      if (o->rest_delta) { /* M rest_delta = displacement, M the vertex's blended matrix */
         float m[12], back[3];
         const uint32_t *joint = view->skin_joint + v * view->influences;
         const float *weight = view->skin_weight + v * view->influences;
         if (j->r->skinning == DN_DQS) dn__dqs_blend(joint, weight, view->influences, j->f->dual, m);
         else dn__lbs_blend(joint, weight, view->influences, j->f->palette, m);
         dn__unskin(m, shift, back);
         memcpy(dn__strided(o->rest_delta, dn__stride(o->rest_delta_stride, 12), v), back, 12);
      }
   }
}
static void dn__refined_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__output_job *j = (const dn__output_job *)job;
   size_t i;
   (void)worker;
   for (i = begin; i < end; i++) /* a node's vertices may carry different masks: the first one speaks for it */
      memcpy(j->f->framed + 3 * i, j->f->skinned + 3 * (size_t)j->r->view.first_vertex[i], 12);
}
static void dn__node_normals_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__output_job *j = (const dn__output_job *)job;
   (void)worker;
   dn__normals_range(j->f->framed, j->r->view.triangle, j->r->corner_first, j->r->corner_tri, begin, end, j->f->normals);
}
static void dn__normals_out_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__output_job *j = (const dn__output_job *)job;
   size_t v;
   (void)worker;
   for (v = begin; v < end; v++)
      memcpy(dn__strided(j->out->normals, dn__stride(j->out->normal_stride, 12), v), j->f->normals + 3 * (size_t)j->r->view.node_of_vertex[v], 12);
}
DN_API dn_result dn_stage_output(const dn_rig *rig, const dn_pose *pose, dn_output *out, void *scratch,
                                 const dn_parallel *parallel, dn_error *err)
{
   dn__frame f = dn__frame_of(rig, scratch, dn__workers(parallel));
   dn__output_job job;
   size_t v, k;
   DN_ASSERT(out && pose);
   job.r = rig;
   job.f = &f;
   job.pose = pose;
   job.out = out;
   job.strength = dn__unit_clamp(pose->strength);
   dn__for(parallel, rig->view.vertices, 1024, dn__output_range, &job);
   for (k = 0; k < 3; k++) {
      out->bounds_min[k] = 3.402823466e38f;
      out->bounds_max[k] = -3.402823466e38f;
   }
   for (v = 0; v < rig->view.vertices; v++)
      for (k = 0; k < 3; k++) {
         float x = f.skinned[3 * v + k];
         if (x < out->bounds_min[k]) out->bounds_min[k] = x;
         if (x > out->bounds_max[k]) out->bounds_max[k] = x;
      }
   if (out->normals) {
      dn__for(parallel, rig->view.nodes, 1024, dn__refined_range, &job);
      dn__for(parallel, rig->view.nodes, 512, dn__node_normals_range, &job);
      dn__for(parallel, rig->view.vertices, 1024, dn__normals_out_range, &job);
   }
   out->fallback_nodes = f.state[0];
   if (f.state[0] == 0 && f.state[1]) return DN_OK;
   return dn__fail_sizes(err, DN_NOT_FINITE, "frame", SIZE_MAX, f.state[1] ? "nodes plainly skinned: " : "the palette is not finite; nodes plainly skinned: ", f.state[0], " of ",
                         rig->view.nodes, NULL);
}

DN_API dn_result dn_deform(const dn_rig *rig, const dn_pose *pose, dn_output *out, void *scratch, size_t scratch_bytes,
                           const dn_parallel *parallel, dn_error *err)
{
   dn_result r = dn_stage_skin(rig, pose, scratch, scratch_bytes, parallel, err);
   if (r != DN_OK) return r;
   dn_stage_rows(rig, scratch, parallel);
   dn_stage_network(rig, scratch, parallel, NULL);
   return dn_stage_output(rig, pose, out, scratch, parallel, err);
}
/* the workers do not move what lies before the network's buffers, so any count finds these */
DN_API const float *dn_scratch_coarse(const dn_rig *rig, const void *scratch) { return dn__frame_of(rig, (void *)(uintptr_t)scratch, 1).coarse; }
DN_API const float *dn_scratch_rows(const dn_rig *rig, const void *scratch) { return dn__frame_of(rig, (void *)(uintptr_t)scratch, 1).rows; }
DN_API const float *dn_scratch_displacement(const dn_rig *rig, const void *scratch) { return dn__frame_of(rig, (void *)(uintptr_t)scratch, 1).displacement; }

/* --- bind's last step for "rest" pooling: the network up to its pool with every palette entry the identity */
static dn_result dn__bind_clusters(dn__bind *b, dn_rig *r)
{
   dn__arena a = dn__arena_of(b->work, b->work_bytes);
   float *identity = (float *)dn__take(&a, dn__mul(b->joints, 12), sizeof(float));
   unsigned char *scratch = (unsigned char *)b->work + a.used;
   size_t s, k, bytes = b->work_bytes - a.used;
   const dn_parallel *par = b->desc->parallel;
   dn_pose pose;
   dn__frame f;
   dn__run run;
   dn__rows_job job;
   const float *x;
   dn_result result;
   if (dn__step(b, "rest pooling", 0.0f)) return dn__cancelled(b);
   for (s = 0; s < b->joints; s++)
      for (k = 0; k < 12; k++) identity[12 * s + k] = k % 5 == 0 ? 1.0f : 0.0f;
   memset(&pose, 0, sizeof pose);
   pose.palette = identity;
   if ((result = dn_stage_skin(r, &pose, scratch, bytes, par, b->err)) != DN_OK) return result;
   dn_stage_rows(r, scratch, par);
   f = dn__frame_of(r, scratch, dn__workers(par));
   job.r = r;
   job.f = &f;
   if (r->model->input_mean) dn__for(par, b->nodes, 512, dn__normalise_range, &job);
   run.m = r->model;
   run.g = &r->view.graph;
   run.n = &f.net;
   run.par = par;
   run.probe = NULL;
   x = dn__run_pre(&run, f.rows);
   dn_pool_scores(&r->model->pool, run.g, x, f.net.wide_width, f.net.scores, f.net.pool, par);
   dn_pool_contract(run.g, f.net.scores, &r->clusters, f.net.pool);
   r->has_clusters = 1;
   return DN_OK;
}

/* the private macros go: what stays defined is documented in >>config, >>types and >>layers */
#undef DN__AHEAD
#undef DN__ALIGN
#undef DN__ALL
#undef DN__BLOCK
#undef DN__BUCKETS
#undef DN__EACH14
#undef DN__EACH3
#undef DN__EACH6
#undef DN__EXP_0
#undef DN__EXP_1
#undef DN__EXP_2
#undef DN__EXP_3
#undef DN__EXP_4
#undef DN__EXP_HIGH
#undef DN__EXP_LOW
#undef DN__F4_EACH
#undef DN__F4_KERNEL
#undef DN__F4_NEON
#undef DN__F4_ROWS
#undef DN__F4_SSE
#undef DN__F4_WASM
#undef DN__FAR
#undef DN__GRAIN
#undef DN__HAS_AVX2
#undef DN__HAS_AVX512
#undef DN__HAS_F4
#undef DN__HEADER_CAP
#undef DN__INLINE
#undef DN__LN2_HIGH
#undef DN__LN2_LOW
#undef DN__LOG2E
#undef DN__MOST
#undef DN__NONE
#undef DN__PROBE_CAP
#undef DN__RANK_CAP
#undef DN__RUN
#undef DN__SEEDS
#undef DN__SOURCE
#undef DN__TANH_0
#undef DN__TANH_1
#undef DN__TANH_2
#undef DN__TANH_3
#undef DN__TANH_4
#undef DN__TANH_SMALL
#undef DN__TARGET_AVX2
#undef DN__TARGET_AVX512
#undef DN__TOUCH
#undef DN__WEIGHTS

#endif /* DEFORMNET_IMPLEMENTATION */

/*
This software is available under two licences; choose whichever you prefer.
-------------------------------------------------------------------------------
ALTERNATIVE A - MIT License
Copyright (c) 2026 the deformnet authors
Permission is hereby granted, free of charge, to any person obtaining a copy of
this software and associated documentation files (the "Software"), to deal in
the Software without restriction, including without limitation the rights to
use, copy, modify, merge, publish, distribute, sublicense, and/or sell copies
of the Software, and to permit persons to whom the Software is furnished to do
so, subject to the following conditions:
The above copyright notice and this permission notice shall be included in all
copies or substantial portions of the Software.
THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR
IMPLIED, INCLUDING BUT NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY,
FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
AUTHORS OR COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER
LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM,
OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE
SOFTWARE.
-------------------------------------------------------------------------------
ALTERNATIVE B - Public Domain (www.unlicense.org)
This is free and unencumbered software released into the public domain.
Anyone is free to copy, modify, publish, use, compile, sell, or distribute this
software, either in source code form or as a compiled binary, for any purpose,
commercial or non-commercial, and by any means.
In jurisdictions that recognize copyright laws, the author or authors of this
software dedicate any and all copyright interest in the software to the public
domain. We make this dedication for the benefit of the public at large and to
the detriment of our heirs and successors. We intend this dedication to be an
overt act of relinquishment in perpetuity of all present and future rights to
this software under copyright law.
THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR
IMPLIED, INCLUDING BUT NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY,
FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
AUTHORS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN
ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM, OUT OF OR IN CONNECTION
WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE.
*/
