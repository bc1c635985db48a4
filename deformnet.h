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
               dn_model *model = dn_model_load_file("humanoid.safetensors", NULL, NULL, &err);
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
               >>config >>types >>bind >>model >>deform >>budget >>layers >>parts >>kit
               >>garments >>dressed >>blendshapes                                      (what you call)
               >>base >>tensors >>mesh >>skin >>geodesic >>kernels >>lbs >>features >>attention
               >>reduced >>pooling >>networks >>garmentnets >>rig >>frame >>budget >>kit
               >>garment >>dressed >>blend                                             (how it works)
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
   DN_EXACT           implementation  off           the same bits from every compiler, optimisation and processor (its terms are
                                                    in >>base); reference kernels only, of every precision: several times slower
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

/* Which text runs. Automatic: the fastest one that works here. Layers store the one that packing chose; tests may
   overwrite it with any available one. */
typedef enum dn_kernel { DN_KERNEL_AUTO, DN_KERNEL_REF, DN_KERNEL_SSE, DN_KERNEL_AVX2, DN_KERNEL_AVX512, DN_KERNEL_NEON,
                         DN_KERNEL_WASM, DN_KERNEL_COUNT } dn_kernel;
DN_API int dn_kernel_available(dn_kernel kernel); /* compiled in, and this processor and system run it; 0 for automatic */
DN_API const char *dn_kernel_name(dn_kernel kernel); /* "reference", "sse", "avx2", "avx512", "neon", "wasm"; automatic: of
                                                        the one it chooses; never NULL */

/* ===================================================================================== >>model
   A model is immutable after load and may be shared by any number of threads and rigs. It keeps no pointer
   into the file's bytes. */
typedef struct dn_model dn_model;

typedef enum dn_arch {
   DN_MLP, DN_GAT, DN_NEUROSKINNING, DN_DENSEGATS, DN_MULTIRESGNET, /* for dn_rig_create */
   DN_GARFIT_COARSE, DN_GARFITNET, DN_CLOTHNET,                     /* for dn_garment_create */
   DN_NEURALBLENDSHAPES                                             /* for dn_blend_create */
} dn_arch;
typedef enum dn_pooling { DN_POOL_DYNAMIC, DN_POOL_REST } dn_pooling;
typedef enum dn_feature { DN_POSITION, DN_RELATIVE, DN_NORMAL, DN_GEODESIC, DN_DISTANCE, DN_FIT } dn_feature;

/* What weights and rows are made of. The first layers (pre.*) and the last (out) are float32 in all of them. */
typedef enum dn_precision {
   DN_PRECISION_F32,
   DN_PRECISION_F16,  /* weights IEEE half, rows float32 */
   DN_PRECISION_BF16, /* weights and rows bfloat16, sums float32 */
   DN_PRECISION_INT8, /* weights and rows 8 bits, sums int32; the file needs ranges (examples/calibrate) */
   DN_PRECISION_COUNT
} dn_precision;
DN_API const char *dn_precision_name(dn_precision precision); /* "f32", "f16", "bf16", "int8"; else "unknown" */

typedef struct dn_model_options { /* zero-filled or NULL: float32, the fastest kernel here */
   dn_precision precision;
   dn_kernel kernel;              /* of the layers; of skinning too, where dn_rig_desc names none */
} dn_model_options;

typedef struct dn_model_info { /* strings and arrays belong to the model */
   dn_arch arch;
   const char *arch_name;
   size_t row_width;                /* D */
   size_t feature_count;
   const dn_feature *features;      /* in row order */
   size_t fit;                      /* n of "fit:n"; 0: no fit factors in the rows */
   size_t detail_width, detail_feature_count, detail_fit; /* the same of clothnet's detail stage; 0 elsewhere */
   const dn_feature *detail_features;
   size_t parser;                   /* numbers that garfitnet and clothnet read of alpha, beta and theta together; 0 elsewhere */
   size_t joints;                   /* S: columns of geodesic and distance, or names; 0: none of the three */
   const char *const *joint_names;  /* (S) or NULL: joints then match by index */
   int root_frame;                  /* deformnet.frame == "root" */
   dn_pooling pooling;
   float unit;                      /* metres per unit of the training data; not applied: pass the mesh in its units */
   const char *licence, *trained_on; /* "" when the file has none */
   dn_precision precision;
   dn_kernel kernel;                /* the one in use: never DN_KERNEL_AUTO */
   size_t parameters;               /* numbers in the tensors used */
   size_t bytes;                    /* memory the model occupies */
} dn_model_info;

/*  dn_model_load - read a model from memory

    file      size bytes of a .safetensors file (spec: networks.md, section 6); not kept, any alignment
    options   NULL: float32, the fastest kernel here
    allocator NULL for DN_MALLOC; the model remembers it
    errors    NULL, and *err names the tensor, metadata key or option, what was found and what was expected
    memory    at most a small multiple of the file; nothing is allocated before the header is checked
    threads   re-entrant */
DN_API dn_model *dn_model_load(const void *file, size_t size, const dn_model_options *options,
                               const dn_allocator *allocator, dn_error *err);
#ifndef DN_NO_STDIO
/*  the same from a path; DN_IO when the file cannot be opened or read */
DN_API dn_model *dn_model_load_file(const char *path, const dn_model_options *options, const dn_allocator *allocator,
                                    dn_error *err);
#endif
/*  after the last rig that uses it; NULL is allowed; does nothing to a model made by dn_model_init, whose memory is yours */
DN_API void dn_model_free(dn_model *model);

/*  dn_model_size, dn_model_init - the same without an allocator, from an opened file (dn_tensors_open, >>parts)

    options    the same for both
    bytes      kept by the model; scratch is needed during dn_model_init only; both exact
    memory     both 64-byte aligned; memory must outlive the model, *model lies inside it. The file may go afterwards
    errors     as dn_model_load; DN_TOO_SMALL names both sizes; *model is NULL then
    threads    re-entrant */
typedef struct dn_tensors dn_tensors;
DN_API dn_result dn_model_size(const dn_tensors *file, const dn_model_options *options, size_t *bytes, size_t *scratch,
                               dn_error *err);
DN_API dn_result dn_model_init(const dn_tensors *file, const dn_model_options *options, void *memory, size_t bytes,
                               void *scratch, size_t scratch_bytes, dn_model **model, dn_error *err);
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

typedef enum dn_order {       /* how bind numbers the nodes */
   DN_ORDER_GIVEN,            /* by first appearance in the mesh, as the spec says */
   DN_ORDER_NEAR              /* neighbours near one another: less scratch, less time where the mesh's own order jumps
                                 about. Attention then adds a node's neighbours in another order: results differ by
                                 rounding, and dynamic pooling breaks ties of scores otherwise */
} dn_order;

typedef struct dn_rig_desc {   /* borrowed during bind only */
   dn_mesh mesh;
   dn_skeleton skeleton;
   dn_skinning skinning;       /* what the coarse mesh is; models are trained on one, mostly LBS */
   dn_kernel kernel;           /* of the skinning; automatic: the model's, or the fastest here */
   float weld_distance;        /* vertices at most this far apart at rest may weld; 0: equal positions */
   unsigned resolution;        /* voxels along the longest side for geodesic distance; 0: 128, at most 512 */
   dn_order order;             /* of the nodes in the view and the probe; the caller's vertices keep theirs */
   const float *geodesic;      /* (N,S_model) known distances, or NULL: compute. Joints as in the model; nodes by first
                                  appearance whatever `order` says, which is by rising first_vertex of the view */
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

typedef struct dn_probe { /* sees every block's output by tensor name: "pre.0" (N,64); for tests */
   void (*tap)(void *user, const char *name, const float *rows, size_t first /* node */, size_t count, size_t width,
               size_t row_stride); /* of one name in chunks of rising nodes, those of several blocks in turns: they are
                                      under way together, and their rows are gone when the call returns */
   void (*pool)(void *user, const char *name, const uint32_t *members /* (M,2) */, const float *score, size_t count);
   void *user;
} dn_probe;
/*  The four stages of dn_deform, for engines that time or schedule them apart. Call each once a frame, in this order,
    with the same rig, pose, scratch and number of workers: each works in place on what the one before left there.
    dn_deform is exactly these four.

    skin       palette -> skinned vertices (T 2.1, T 2.2); the one that checks scratch_bytes: go on only after DN_OK
    rows       -> the descriptors that the pose changes, in the network's frame (spec section 3). What the geodesic
               columns add to the first layer was computed when the rig was bound: dn_rows gives complete rows
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
/*  rows (N,D) written: every descriptor in the order of deformnet.features, not normalised. For tools, tests and training:
    no frame needs them. Between dn_stage_rows and dn_stage_network of a rig with a model; re-entrant, cannot fail */
DN_API void dn_rows(const dn_rig *rig, const void *scratch, float *rows);
/*  what the stages left in scratch, per node; 64-byte aligned, valid until the next call that uses the scratch */
DN_API const float *dn_scratch_coarse(const dn_rig *rig, const void *scratch);       /* (N,3) skinned */
DN_API const float *dn_scratch_displacement(const dn_rig *rig, const void *scratch); /* (N,3) posed, model space */

/* ===================================================================================== >>budget
   The network in fewer frames, or on fewer nodes, for characters that are many or far away, or a slow machine. What a run
   of it finds is taken to rest space, where it changes slowly, kept in the caller's memory, and carried in every frame by
   each node's own rotation: no frame shows an old pose, only a correction of a moment ago. README (Cost) has what it loses.

   flow       now and then, on any thread, with a full scratch:
                 dn_evaluate(rig, pose) -> correction (N,3), or
                 dn_evaluate(coarse rig, pose) -> (M,3) -> dn_spread -> correction (N,3)
              every frame, with a small scratch:
                 dn_track_put(correction) when there is a new one, dn_track_advance, dn_carry(pose) -> dn_output
   stagger    character c is due in frame f when (f + c) % k == 0: a k-th of the characters in every frame
   jobs       a job copies the palette, calls dn_evaluate with a scratch and a correction buffer of its own, and the frames'
              thread puts that on the track when the job is done: they share nothing else (examples/crowd.c). m frames of
              work are m frames of lag: a correction many frames late is worse than none. Without background jobs, call
              dn_stage_skin and _rows in one frame, _network in the next, then dn_stage_keep, on a scratch of their own
   not here   garments: they collide with the body of the frame at hand, so their displacement cannot wait */

/*  dn_evaluate - the network's displacement for a pose, in rest space

    equation   c_i = R_i^T Delta_i, R_i the rotation (spec section 2, orthonormalised) of node i's blended matrix: that of
               its first vertex, T 2.1 or T 2.2. Not its inverse, which rest_delta wants: where skinning collapses an inverse
               has no bound, and carried to another pose it was a little farther from the truth
    pose       palette and matrix, and skinned if given; strength and mask belong to dn_carry
    correction (N,3) written in full, in the rig's node order; 0 where the network was not finite
    scratch    dn_scratch_size(rig, workers) bytes, as dn_deform
    returns    as dn_deform
    threads    re-entrant; no allocation; bits independent of parallel
    dn_stage_keep is its last step, for those who call dn_stage_skin, _rows and _network themselves */
DN_API dn_result dn_evaluate(const dn_rig *rig, const dn_pose *pose, float *correction, void *scratch, size_t scratch_bytes,
                             const dn_parallel *parallel, dn_error *err);
DN_API void dn_stage_keep(const dn_rig *rig, const void *scratch, float *correction, const dn_parallel *parallel);

/*  dn_track - one character's correction between evaluations

    what is shown glides from where it was when the last evaluation came to that evaluation, over `span`; it never jumps,
    however irregularly they come. Evaluated every k frames with span k, it lags k - 1 frames: none for k = 1, when it is
    dn_deform within rounding. The pose itself has no lag
    lead       aims past the evaluation by that share of its step from the one before: 0 is the smoothest and lags most,
               0.25 (fast motion) to 0.5 (slower) came nearest to the truth, with evaluations every 2 to 4 frames; 1 overshoots
    ahead      where the motion is known, evaluate the pose of k - 1 frames on: with lead 0 the lag is gone
    hold       span 0 shows an evaluation at once: nearer to the truth than gliding with lead 0, but it pops
    memory     dn_track_size(nodes) bytes, 64-byte aligned, outlives the track; SIZE_MAX: does not fit
    threads    put and advance change the track; dn_carry only reads it */
typedef struct dn_track { /* written by the functions below */
   size_t nodes;
   float *from, *to;      /* (N,3) what was shown when the last evaluation came; where it glides to */
   float *last;           /* (N,3) that evaluation */
   float span, at;        /* the glide's length in the caller's unit, frames or seconds; how much of it is past */
   int filled;            /* 0: nothing put yet, plain skinning */
} dn_track;
DN_API size_t dn_track_size(size_t nodes);
/*  an empty track; also after a cut or a teleport: the next evaluation is then shown at once */
DN_API void dn_track_init(dn_track *track, size_t nodes, void *memory);
/*  correction (N,3) is copied; the glide starts anew. span at least 0, lead 0 .. 1 (clamped) */
DN_API void dn_track_put(dn_track *track, const float *correction, float span, float lead);
/*  once a frame, after dn_track_put and before dn_carry: 1, or the frame's seconds where span is in seconds */
DN_API void dn_track_advance(dn_track *track, float step);

/*  dn_carry - a frame without the network: skin, and add the track's correction

    equation   v_i = p_i + strength mask_i R_n c_n, n the node of vertex i, R_n as in dn_evaluate, but of this pose:
               one displacement a node, so seams stay closed
    rig        the full character's; its model is not used and may be NULL
    pose, out, returns, threads: as dn_deform, rest_delta included
    scratch    dn_carry_scratch(rig, workers) bytes: without the network's rows; DN_TOO_SMALL when it is less */
DN_API size_t dn_carry_scratch(const dn_rig *rig, unsigned workers);
DN_API dn_result dn_carry(const dn_rig *rig, const dn_pose *pose, const dn_track *track, dn_output *out, void *scratch,
                          size_t scratch_bytes, const dn_parallel *parallel, dn_error *err);

/*  dn_coarse - a mesh with a share of the nodes, for the network to run on, and the way back to the full mesh

    Neighbours are drawn together (an edge contracts into one of its ends) where the surface is flat and the skin weights
    are alike, evenly over the body. Kept nodes are the full rig's own: rest position, skin weights and geodesic distances
    included. Borders, components and sheets that meet in an edge stay. Bind a rig to it like to any other mesh.

    full       the full character's rig; bound without a model it has no geodesic distances, and the coarse rig's bind
               computes them on the coarse mesh instead. May be freed afterwards
    share      of its nodes to keep, above 0, at most 1; fewer than asked go where the mesh does not allow more
    bytes      dn_coarse_size: kept, an upper bound; scratch: during dn_coarse_init only. Both 64-byte aligned. memory
               outlives the coarse rig's bind and the last dn_spread; coarse->bytes of it are used
    errors     DN_BAD_VALUE (share), DN_TOO_SMALL names both sizes; *coarse is then of no use
    cost       13,380 nodes: 0.14 s of processor time to a half, 0.21 s to a quarter
    threads    re-entrant

    dn_coarse_describe: the full character's description with mesh and geodesic replaced, for dn_rig_create or dn_rig_init;
    pose.skinned and mask do not fit a coarse rig: leave them NULL in its dn_evaluate.

    dn_spread: c_i = sum_k s_ik c_k over the corners of the coarse triangle nearest to node i, sought around the node that i
    was drawn into, not in space: lips and fingers that lie side by side do not mix. s_ik >= 0 and sum to one; a kept node
    has its own. rig: bound to coarse->mesh; correction (M,3) of its dn_evaluate; full (N,3) written, for dn_track_put */
typedef struct dn_coarse {        /* written by dn_coarse_init, read only; points into its memory */
   size_t nodes, full;            /* M, N */
   const uint32_t *node;          /* (M) the full rig's node that each is */
   dn_mesh mesh;                  /* M vertices, one a node */
   const uint32_t *skin_joint;    /* (M,I) */
   const float *skin_weight;      /* (M,I) */
   const float *geodesic;         /* (M,S_model) or NULL */
   const uint32_t *spread_node;   /* (N,3) vertices of mesh */
   const float *spread_weight;    /* (N,3) */
   size_t bytes;                  /* of memory used */
} dn_coarse;
DN_API dn_result dn_coarse_size(const dn_rig *full, size_t *bytes, size_t *scratch, dn_error *err);
DN_API dn_result dn_coarse_init(const dn_rig *full, float share, void *memory, size_t bytes, void *scratch,
                                size_t scratch_bytes, dn_coarse *coarse, dn_error *err);
DN_API void dn_coarse_describe(const dn_coarse *coarse, const dn_rig_desc *full, dn_rig_desc *desc);
DN_API void dn_spread(const dn_coarse *coarse, const dn_rig *rig, const float *correction, float *full,
                      const dn_parallel *parallel);

/* ===================================================================================== >>layers
   The networks' building blocks, to compose your own. A layer is packed once into memory you give (weights
   in panels of DN_PANEL columns, batch norm and bias beside them) and then only read. Rows x and y have a stride
   in floats, so that several blocks can share one wide row (a dense module concatenates in place).
   All of them: re-entrant, no allocation, memory and scratch 64-byte aligned; out must not overlap in unless said;
   bits independent of parallel; sizes that do not match are the caller's mistake, asserted where they can be seen.
   Each has a plain *_ref twin, the specification (dn_pool_rescore: dn_pool_scores_ref of the chosen pairs):
   dn_pool_contract equals it, the others stay within 1e-5 + 1e-4 |x| of it. */
#define DN_PANEL 16

typedef enum dn_activation {
   DN_ACT_NONE, DN_ACT_TANH, DN_ACT_RELU, DN_ACT_LEAKYRELU /* slope 0.2 */, DN_ACT_TANHSHRINK /* x - tanh x */,
   DN_ACT_SOFTMAX /* over the row */
} dn_activation;

typedef struct dn_batchnorm { const float *weight, *bias, *mean, *var; } dn_batchnorm; /* (C) each, eps 1e-5 */

typedef struct dn_linear {  /* y = act(bn(W x + b)) */
   size_t in, out;
   dn_activation activation;
   const float *panels;     /* (ceil(out/16), in, 16) */
   const float *columns;    /* (ceil(out/16), 5, 16) bias and batch norm: y = act((W x + start) scale + shift), zero
                               padded; NULL: y = act(W x) */
   const float *add;        /* (rows,out), packed, or NULL: added to each row after the batch norm, before the activation */
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
   const float *columns;    /* (.., 5, 16) as dn_linear's */
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
DN_API void dn_dense_ref(const dn_gat *blocks, size_t count, const dn_graph *g, float *rows, size_t row_stride, size_t width,
                         void *scratch);
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
DN_API void dn_pool_scores_ref(const dn_pool *pool, const dn_graph *g, const float *v, size_t v_stride, float *scores);
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
DN_API void dn_pool_gather_ref(const dn_pool *pool, const dn_clusters *c, const float *v, size_t v_stride, size_t width,
                               float *coarse, size_t coarse_stride);
DN_API void dn_pool_gather(const dn_pool *pool, const dn_clusters *c, const float *v, size_t v_stride, size_t width,
                           float *coarse, size_t coarse_stride, const dn_parallel *parallel);
DN_API void dn_pool_scatter_ref(const dn_pool *pool, const dn_clusters *c, const float *coarse, size_t coarse_stride,
                                size_t width, size_t nodes, float *v, size_t v_stride);
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
    the palette's S; palette (S,12) row-major 3x4 -> out (count,3), which may be rest. dn_lbs sums in float, 1,023 points
    and fewer in double: within 6e-8 (influences + 5) times the sum of its terms' sizes of the exact point */
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


/* ===================================================================================== >>kit
   What garments and parametric bodies are made of, callable on its own under the rules of >>parts: re-entrant, no
   allocation, packed arrays, inputs trusted, scratch 64-byte aligned, bits independent of parallel. dn_shape is the
   exception: it comes from a file, and is checked like a model. */

/*  dn_associate - the closest body node of every garment node in the rest pose, the lowest index of several (T 4.3, C 4.1)

    body       (B,3), B at least 1; points (N,3), the garment's; both finite
    nearest    (N) written
    scratch    dn_associate_scratch(B) bytes: a grid over the body, about four cells a node
    cost       5,000 points on 13,000 nodes: 1.4 ms; the plain twin, the specification, tries every pair
    result     equal to the twin's */
DN_API size_t dn_associate_scratch(size_t body_nodes);
DN_API void dn_associate(const float *body, size_t body_nodes, const float *points, size_t count, uint32_t *nearest,
                         void *scratch, const dn_parallel *parallel);
DN_API void dn_associate_ref(const float *body, size_t body_nodes, const float *points, size_t count, uint32_t *nearest);

/*  dn_even_selection - `wanted` nodes spread evenly over a garment (C 4.1): those at which its fit is measured

    kept       going by index, a node closer than r = sqrt(area / (C wanted)) to a kept one is rejected; C = 1, 2, ...
               until `wanted` are kept; past 4096 (coincident nodes) nothing is rejected
    area       of the garment's surface, dn_area
    selection  (wanted) written, ascending
    spacing    C, may be NULL; 4097 when nothing was rejected
    returns    DN_OK; DN_BAD_MESH when there are fewer nodes than wanted: err names both
    scratch    dn_even_selection_scratch(nodes) bytes */
DN_API double dn_area(const float *positions, const uint32_t *triangle, size_t triangles);
DN_API size_t dn_even_selection_scratch(size_t nodes);
DN_API dn_result dn_even_selection(const float *positions, size_t nodes, double area, size_t wanted, uint32_t *selection,
                                   unsigned *spacing, void *scratch, dn_error *err);

/*  dn_smooth - Laplacian smoothing (C 5.1: 40 iterations, factor 0.12): p_i += factor (mean of N(i) - p_i), all nodes at
    once; isolated nodes stay. positions (N,3) in place; scratch (N,3) floats */
DN_API void dn_smooth(const dn_graph *g, float *positions, unsigned iterations, float factor, float *scratch,
                      const dn_parallel *parallel);

/*  dn_factor_fit - maximum-likelihood factor analysis of a distance matrix (T 4.4, C 3; Barber, Bayesian Reasoning and
    Machine Learning, 21.2): D - mean ~ L A, noise variances Psi. For tools: fits the alpha of garments without Python.

    round      X = Psi^-1/2 (D - mean) / sqrt(pairs) = U diag(s) W;  L = Psi^1/2 U_n sqrt(max(s_n^2 - 1, 0));
               Psi = diag(S - L L^T), never under 1e-6 of the row's variance nor 1e-12. L is the best for its Psi, and
               Psi's step is then EM's: the likelihood never falls
    ends       when the mean log-likelihood gains less than 1e-12 of itself, or after 20,000 rounds. Where it is nearly
               flat (rows almost without noise, few pairs) that is short of the top: two starts may then end a hundredth
               of L's largest entry apart; and factors that do not stand out can give it more than one top
    sign       in each column of L the entry of largest magnitude is positive; factors by falling singular value
    distances  (rows,pairs), row-major, finite: one row a measured node, one column a garment on a body
    start      (rows) noise variances to start from, above 0; NULL: the rows' variances
    outputs    each may be NULL; written on DN_OK and DN_CANCELLED. history: the likelihood after each round, as far as
               it has room
    errors     DN_BAD_SHAPE (no rows, fewer than two pairs, factors not in 1 .. min(rows, pairs)), DN_BAD_VALUE (not
               finite, a start not above 0), DN_TOO_SMALL, DN_CANCELLED
    cost       per round an eigendecomposition of min(rows, pairs), in double: 60 x 48 takes 0.2 ms, 500 x 600 0.17 s
    scratch    dn_factor_scratch(rows, pairs, factors) bytes; SIZE_MAX: does not fit */
typedef struct dn_factor_desc {
   const float *distances;
   size_t rows, pairs, factors;
   const float *start;
   const dn_progress *progress; /* called every round; done is the share of 20,000 rounds: most fits end long before */
   float *mean;                 /* (rows) */
   float *loading;              /* (rows,factors) L */
   float *noise;                /* (rows) Psi's diagonal */
   float *projection;           /* (factors,rows): alpha = projection (d - mean) */
   float *alpha;                /* (factors,pairs) of the columns themselves */
   double *history;             /* (history_count) */
   size_t history_count;
   size_t rounds;               /* written */
   double log_likelihood;       /* written: the mean over pairs */
} dn_factor_desc;
DN_API size_t dn_factor_scratch(size_t rows, size_t pairs, size_t factors);
DN_API dn_result dn_factor_fit(dn_factor_desc *desc, void *scratch, size_t scratch_bytes, dn_error *err);
/*  dn_factor_project - the run-time half: alpha = (I + L^T Psi^-1 L)^-1 L^T Psi^-1 (d - mean), one product with the stored
    matrix (`fit.projection`, `fit.mean`). projection (factors,rows), mean and d (rows) -> alpha (factors) */
DN_API void dn_factor_project(const float *projection, const float *mean, const float *d, size_t rows, size_t factors,
                              float *alpha);

/*  dn_surface - a posed triangle mesh that can be asked where its closest point is, and on which side one stands

    positions  (V,3); triangle (T,3), T at least 1, counter-clockwise from outside; both borrowed until the last query.
               Vertices at one place should be one vertex: a split seam counts as an open border
    memory     dn_surface_size(V, T) bytes, 64-byte aligned; build it again when the positions have changed
    cost       26,756 triangles: 2.3 ms to build, 3 us a query */
typedef struct dn_surface { /* written by dn_surface_build */
   const float *positions;
   const uint32_t *triangle;
   size_t vertices, triangles;
   const uint32_t *corner_first, *corner_tri; /* (V+1), (3T): the triangles at each vertex */
   const uint32_t *order;                     /* (T) triangles along a space-filling curve, cut evenly into leaves */
   const float *boxes;                        /* (2 leaves,6) a binary tree: box i holds 2i and 2i+1, the root is 1 */
   size_t leaves;                             /* a power of two */
   float extent;                              /* the box's diagonal */
} dn_surface;
DN_API size_t dn_surface_size(size_t vertices, size_t triangles);
DN_API void dn_surface_build(dn_surface *surface, const float *positions, size_t vertices, const uint32_t *triangle,
                             size_t triangles, void *memory);
/*  signed distance of a finite point, negative inside; closest (3) and normal (3, unit, away from the surface's inside,
    along which the distance grows; on the surface itself the surface's normal) may be NULL. The side is told by the
    angle-weighted normal of the closest face, edge or vertex (Baerentzen and Aanaes 2005), which is exact on a closed
    surface; at an open border only what lies within 60 degrees under the normal is inside. _ref tries every triangle */
DN_API float dn_surface_distance(const dn_surface *surface, const float point[3], float *closest, float *normal);
DN_API float dn_surface_distance_ref(const dn_surface *surface, const float point[3], float *closest, float *normal);

/*  dn_collide - garment vertices inside the body, or closer to it than a margin, go out along its normal to the margin

    obstacles  the posed body, then the garments worn under this one, already collided: layers from inner to outer are
               calls in that order
    graph      one-rings of the garment, or NULL. With it the push spreads over the pushed vertices: where one must go
               far its neighbours follow, none goes less far than it must
    moved      only vertices that were closer than a margin; all others keep their bits
    result     every vertex at its margins or further out, but for those squeezed where there is no such place close by
               (between arm and chest): they end where the nearest surface is farthest, and are counted
    positions  (V,3) in place; vertices that are not finite are left alone
    scratch    dn_collide_scratch(V) bytes
    cost       4,300 vertices on 26,756 triangles: 14 ms on one core */
typedef struct dn_obstacle {
   const dn_surface *surface;
   float margin; /* to keep, at least 0 */
   float reach;  /* vertices deeper inside than this are not its business; 0: no limit. For garments, which are open */
} dn_obstacle;
typedef struct dn_collision { /* what a pass found */
   size_t inside;     /* vertices behind a surface */
   size_t moved;      /* those and the ones closer than a margin */
   size_t squeezed;   /* moved, and still closer than a margin */
   float deepest;     /* the largest depth behind a surface before, 0 when there was none */
   float farthest;    /* the longest way that a vertex went */
   float left;        /* the most by which a squeezed vertex misses its margin */
} dn_collision;
DN_API size_t dn_collide_scratch(size_t vertices);
DN_API void dn_collide(const dn_obstacle *obstacles, size_t count, const dn_graph *graph, float *positions, size_t vertices,
                       dn_collision *report /* may be NULL */, void *scratch, const dn_parallel *parallel);

/*  dn_shape - a mesh linear in shape coefficients: a parametric body, or a garment that follows one

    tensors    template (V,3), faces (T,3) I32, shapedirs (V,3,B), weights (V,S); optional posedirs (V,3,9(S-1)),
               looseness_dirs (V,3), parents (S) I32 (-1 for roots, else below its own index), and the joints as
               joint_template (S,3) with joint_shapedirs (S,3,B), or as joint_regressor (S,V). Floats are F32, F16, BF16.
               __metadata__ joint_names: a JSON list of S names. Others are ignored
    body       v = template + shapedirs beta + looseness looseness_dirs (+ posedirs (R - I)); joints likewise, or
               joint_regressor v, which is folded into the same two arrays at load
    weights    negative ones count as 0, rows are normalised, an empty row is bound to joint 0
    file, allocator, memory, errors, threads: as dn_model_load, dn_model_size and dn_model_init. V and T may be any that a
               file holds, S and B at most DN_MAX_DIM */
typedef struct dn_shape dn_shape;
typedef struct dn_shape_view { /* what a shape holds; do not write; lives as long as the shape */
   size_t vertices, triangles, coefficients, joints; /* V, T, B, S */
   const float *rest;               /* (V,3) template */
   const uint32_t *triangle;        /* (T,3) */
   size_t influences;               /* I, the most joints that any vertex has */
   const uint32_t *skin_joint;      /* (V,I) by falling weight; unused entries repeat the first, weight 0 */
   const float *skin_weight;        /* (V,I), each row sums to one */
   const int32_t *parents;          /* (S) or NULL */
   const char *const *joint_names;  /* (S) or NULL */
   const float *joint_rest;         /* (S,3) of the template, or NULL */
   int has_looseness, has_pose_offsets;
   size_t bytes;                    /* memory the shape occupies */
} dn_shape_view;
DN_API dn_shape *dn_shape_load(const void *file, size_t size, const dn_allocator *allocator, dn_error *err);
#ifndef DN_NO_STDIO
DN_API dn_shape *dn_shape_load_file(const char *path, const dn_allocator *allocator, dn_error *err);
#endif
DN_API void dn_shape_free(dn_shape *shape); /* as dn_model_free */
DN_API dn_result dn_shape_size(const dn_tensors *file, size_t *bytes, size_t *scratch, dn_error *err);
DN_API dn_result dn_shape_init(const dn_tensors *file, void *memory, size_t bytes, void *scratch, size_t scratch_bytes,
                               dn_shape **shape, dn_error *err);
DN_API void dn_shape_describe(const dn_shape *shape, dn_shape_view *view);
/*  beta (count), count at most B, the others are 0; looseness in metres, no effect on a shape without looseness_dirs
    positions  (V,3) written, or NULL; joints (S,3) written, or NULL; joints need has joints (joint_rest) */
DN_API void dn_shape_evaluate(const dn_shape *shape, const float *beta, size_t count, float looseness, float *positions,
                              float *joints, const dn_parallel *parallel);
/*  positions += posedirs (R - I) of joints 1 .. S-1: the pose-dependent part of an SMPL-family body, at rest, before
    skinning. rotations (S,9) local, row-major; nothing happens without posedirs */
DN_API void dn_shape_pose_offsets(const dn_shape *shape, const float *rotations, float *positions, const dn_parallel *parallel);
/* ===================================================================================== >>garments
   A garment follows a body: every garment node is associated with the body node closest to it at rest, and takes that
   node's skin weights (T 4.3, C 4.1). What is drawn is made in up to three steps, N garment nodes in each:

     followed   the garment's own rest positions, skinned with the weights of their body nodes (T 2.1)
     coarse     posed body node + coarse displacement: a garfit_coarse model (T 4.2), the coarse stage of a clothnet
                model (C 4), or what the pose brings along; without any of them, what was followed
     refined    coarse + displacement: a garfitnet model (T 4.3) or the detail stage of a clothnet model (C 4.4)

   A dn_garment is what depends on the rest pose, the shape and the fit. Any number of threads may deform with it,
   each with its own scratch; only dn_garment_change writes to it. */
typedef struct dn_garment dn_garment;

typedef struct dn_garment_desc { /* borrowed during bind only */
   dn_mesh body;                 /* with skin */
   dn_skeleton skeleton;         /* the body's */
   dn_mesh garment;              /* skin_sets 0; a garment with several layers of cloth is one mesh or several garments */
   const dn_model *coarse;       /* garfit_coarse, or clothnet for its coarse stage, or NULL */
   const dn_model *refine;       /* garfitnet, or clothnet, or NULL; a clothnet here also serves as coarse where that is NULL */
   float weld_distance;          /* as in dn_rig_desc, for both meshes */
   const float *alpha;           /* (alphas) fit factors, finite */
   size_t alphas;                /* at least the n of "fit:n" */
   const float *beta;            /* (betas) shape coefficients, finite */
   size_t betas;
   size_t thetas;                /* numbers in dn_garment_pose.theta; alphas + betas + thetas is what the first layer that
                                    reads them takes, 3 + 10 + 72 in the papers */
   const float *coarse_rest;     /* (N,3) or NULL: coarse displacement of the rest pose, for a garfitnet model with "rest"
                                    pooling whose coarse displacement comes with each pose. NULL: from the coarse model,
                                    or the garment at rest as it is */
   size_t coarse_rest_nodes;     /* N of that array, checked */
   const dn_parallel *parallel;
   const dn_progress *progress;
} dn_garment_desc;

typedef struct dn_garment_report { /* what bind found; nothing here is an error */
   dn_report body, garment;
   size_t body_nodes_used;         /* different body nodes that some garment node is associated with */
   float farthest;                 /* metres from a garment node to its body node at rest, the largest */
} dn_garment_report;

/*  dn_garment_create - bind a garment to a body

    desc       borrowed during the call; its models must outlive the garment
    allocator  NULL for DN_MALLOC; used for the garment and for temporary memory
    report     may be NULL
    errors     NULL, as dn_rig_create; err->where says which of the two meshes. DN_UNSUPPORTED: a model of another kind;
               DN_BAD_SHAPE: alphas, betas and thetas do not add up to what the model reads
    cost       weld and association, near linear in both meshes; "rest" pooling runs the network once up to its pools
    threads    re-entrant */
DN_API dn_garment *dn_garment_create(const dn_garment_desc *desc, const dn_allocator *allocator,
                                     dn_garment_report *report, dn_error *err);
/*  after the last frame that uses it; NULL is allowed; does nothing to a garment made by dn_garment_init */
DN_API void dn_garment_free(dn_garment *garment);
/*  dn_garment_size, dn_garment_init - the same without an allocator

    bytes      kept by the garment, an upper bound from the counts; scratch is needed during dn_garment_init only
    memory     both 64-byte aligned; memory must outlive the garment, *garment lies inside it
    errors     as dn_garment_create; DN_TOO_SMALL names both sizes; *garment is NULL then */
DN_API dn_result dn_garment_size(const dn_garment_desc *desc, size_t *bytes, size_t *scratch, dn_error *err);
DN_API dn_result dn_garment_init(const dn_garment_desc *desc, void *memory, size_t bytes, void *scratch,
                                 size_t scratch_bytes, dn_garment **garment, dn_garment_report *report,
                                    dn_error *err);

typedef struct dn_garment_view {   /* what a garment holds; do not write */
   size_t vertices, nodes;         /* V and N of the garment */
   size_t body_vertices, body_nodes, joints;
   size_t bytes;
   dn_graph graph;                 /* of the garment */
   const uint32_t *node_of_vertex; /* (V) */
   const uint32_t *first_vertex;   /* (N) */
   const float *rest;              /* (N,3) */
   size_t triangles;               /* those with three different nodes */
   const uint32_t *triangle;       /* (triangles,3) node indices */
   const uint32_t *body_node;      /* (N) the associated body node, closest at rest, the lowest index of several */
   const uint32_t *body_node_of_vertex; /* (V of the body) */
   const uint32_t *body_first_vertex;   /* (body nodes) */
   const float *body_rest;         /* (body nodes,3) */
   size_t influences;              /* I */
   const uint32_t *skin_joint;     /* (N,I) of the associated body node */
   const float *skin_weight;       /* (N,I) */
   const float *alpha, *beta;      /* as bound or changed last */
   size_t alphas, betas, thetas;
} dn_garment_view;
/*  fills *view; what it points to lives as long as the garment. Re-entrant, cannot fail */
DN_API void dn_garment_describe(const dn_garment *garment, dn_garment_view *view);

typedef struct dn_garment_changes { /* NULL: as it was. Counts are those of bind */
   const float *body_positions;     size_t body_position_stride;    /* (V of the body,3) at rest; bytes, 0: 12 */
   const float *garment_positions;  size_t garment_position_stride; /* (V,3) at rest */
   const float *inverse_bind;       dn_matrix matrix;               /* (S) matrices, as in dn_skeleton */
   const float *alpha;              /* (alphas) */
   const float *beta;               /* (betas) */
   const float *coarse_rest;        /* (N,3); once given, it stays */
   const dn_parallel *parallel;
} dn_garment_changes;
/*  dn_garment_change - another shape, fit or looseness for the same two meshes

    Only what depends on a change is computed again: new positions renew the association, any change renews the
    contraction of "rest" pooling. The weld stays: a node takes the new position of its first vertex, so where the new
    positions would weld alike, the garment is bit for bit the one that dn_garment_create would make from them.

    scratch    dn_garment_change_size(garment, parallel's workers) bytes, 64-byte aligned
    errors     DN_BAD_MESH (a position that is not finite), DN_BAD_VALUE, DN_BAD_SKIN (an inverse bind that cannot be
               inverted), DN_TOO_SMALL: the garment is as it was
    threads    the only call that writes to a garment: no frame of it may run meanwhile */
DN_API size_t dn_garment_change_size(const dn_garment *garment, unsigned workers);
DN_API dn_result dn_garment_change(dn_garment *garment, const dn_garment_changes *changes, void *scratch,
                                   size_t scratch_bytes, dn_error *err);

typedef struct dn_garment_pose {
   const float *palette;      /* (S) matrices of the body's joints, model space */
   dn_matrix matrix;          /* their layout */
   const float *theta;        /* (thetas) pose parameters, axis-angle, for models that read them; NULL: zeros */
   const float *body;         /* (V of the body,3) the posed body, if you have it (correctives, refinement), or NULL: LBS */
   size_t body_stride;        /* bytes; 0: 12 */
   const float *coarse_displacement; /* (N,3) from the posed body node, model space, in place of a coarse model, or NULL */
   float strength;            /* 0 followed .. 1 refined; clamped. Zero-filled means 0! */
} dn_garment_pose;

typedef struct dn_garment_output { /* any pointer may be NULL, else (V,3) written in full; strides in bytes, 0: 12 */
   float *positions;          size_t position_stride;     /* followed + strength (refined - followed), model space */
   float *normals;            size_t normal_stride;       /* of those positions, unit or (0,0,0) */
   float *coarse;             size_t coarse_stride;       /* the coarse garment */
   float *displacement;       size_t displacement_stride; /* refined - coarse, at full strength */
   float bounds_min[3], bounds_max[3]; /* written: box of the positions, NaN left out */
   size_t fallback_nodes;              /* written: nodes at which a network was not finite: they take the step before */
} dn_garment_output;

/*  dn_garment_deform - one frame: follow, coarse stage, refining stage, output

    scratch    dn_garment_scratch_size(garment, workers) bytes, 64-byte aligned, one per thread or job
    parallel   NULL: this thread only. workers must not exceed what scratch was sized for
    returns    DN_OK; DN_NOT_FINITE as dn_deform, the output is written in full either way; DN_TOO_SMALL
    threads    re-entrant; no allocation, no I/O, no globals; bits independent of parallel */
DN_API dn_result dn_garment_deform(const dn_garment *garment, const dn_garment_pose *pose, dn_garment_output *out,
                                   void *scratch, size_t scratch_bytes, const dn_parallel *parallel, dn_error *err);
DN_API size_t dn_garment_scratch_size(const dn_garment *garment, unsigned workers); /* SIZE_MAX: does not fit */
/*  the same as an allocated block, as dn_scratch_create; give it back with dn_scratch_free */
DN_API void *dn_garment_scratch_create(const dn_garment *garment, unsigned workers, const dn_allocator *allocator,
                                       size_t *bytes, dn_error *err);

/*  The four steps of dn_garment_deform, to be called once a frame in this order with the same garment, pose, scratch
    and number of workers; dn_garment_deform is exactly these four.

    follow     palette, posed body; the one that checks scratch_bytes: go on only after DN_OK
    coarse     the coarse garment. probe: NULL, or it sees the feature rows ("features", in a clothnet model
               "coarse.features") and every block by tensor name, called on this thread
    refine     displacement, and the refined garment at the pose's strength. probe likewise ("detail.features")
    output     the caller's arrays, from dn_garment_nodes.refined as it is then */
DN_API dn_result dn_garment_stage_follow(const dn_garment *garment, const dn_garment_pose *pose, void *scratch,
                                         size_t scratch_bytes, const dn_parallel *parallel, dn_error *err);
DN_API void dn_garment_stage_coarse(const dn_garment *garment, const dn_garment_pose *pose, void *scratch,
                                    const dn_parallel *parallel, const dn_probe *probe);
DN_API void dn_garment_stage_refine(const dn_garment *garment, const dn_garment_pose *pose, void *scratch,
                                    const dn_parallel *parallel, const dn_probe *probe);
DN_API dn_result dn_garment_stage_output(const dn_garment *garment, const dn_garment_pose *pose,
                                         dn_garment_output *out, void *scratch, const dn_parallel *parallel,
                                         dn_error *err);
typedef struct dn_garment_nodes {     /* what the stages left in scratch, model space, until the next call that uses it */
   const float *followed;             /* (N,3) after follow */
   const float *coarse;               /* (N,3) after coarse */
   const float *coarse_displacement;  /* (N,3) after coarse: coarse - posed body node */
   const float *displacement;         /* (N,3) after refine, at full strength */
   float *refined;                    /* (N,3) after refine, at the pose's strength; yours to move before output: what a
                                         collision pass does here reaches every vertex of the node and its normal */
} dn_garment_nodes;
DN_API dn_garment_nodes dn_garment_nodes_of(const dn_garment *garment, void *scratch);

/*  dn_decompose - output decomposition (T 4.8-4.10): y_i = relu(length_i) g_i / |g_i|, g = tanh(direction)

    direction (count,3), length (count) as the last layers give them; y (count,3), which may be direction;
    |g| < 1e-12 gives (0,0,0) */
DN_API void dn_decompose(const float *direction, const float *length, size_t count, float *y);


/* ===================================================================================== >>dressed
   A dressed character: a parametric body (dn_shape with joints) and garments that follow its shape (dn_shapes with the
   same coefficients), bound together. Each frame:

     theta --Rodrigues, kinematics--> palette --pose offsets, skinning, the body's own model--> body vertices
     body --garment models, or following--> garment --collisions with the body and the layers under it--> vertices, normals

   Any number of threads may deform one, each with its own scratch; only dn_dressed_change writes to it. */
typedef struct dn_dressed dn_dressed;

typedef struct dn_dressed_garment {
   const dn_shape *shape;          /* must outlive the dressed character; at most the body's coefficients are used */
   const dn_model *coarse, *refine; /* as in dn_garment_desc; must outlive it too. Both NULL: the garment follows the body */
   const float *alpha;             /* (alphas) fit factors */
   size_t alphas;
   float looseness;                /* metres along the shape's looseness_dirs */
   float margin;                   /* metres to keep from the body and from garments of lower layers; 0: no collision pass */
   unsigned layer;                 /* 0 is next to the skin; garments of one layer do not collide with each other */
   float reach;                    /* as in dn_obstacle, for the garments under this one; 0: 0.05 */
} dn_dressed_garment;

typedef struct dn_dressed_desc {   /* borrowed during creation, but for what its fields say must outlive it */
   const dn_shape *body;           /* with joints and parents; must outlive the dressed character */
   const dn_model *refine;         /* a model that refines the body itself (dn_rig_create), or NULL */
   const float *beta;              /* (betas) shape coefficients; the others are 0 */
   size_t betas;                   /* at most the body's; garment models are given all of the body's */
   const dn_dressed_garment *garment;
   size_t garments;
   size_t thetas;                  /* numbers that garment models read as pose; 0: the 3 S of dn_dressed_pose.theta */
   unsigned resolution;            /* of the body's rig, as in dn_rig_desc */
   const dn_parallel *parallel;
   const dn_progress *progress;    /* the body's bind */
} dn_dressed_desc;

/*  dn_dressed_create - bind body and garments

    allocator  NULL for DN_MALLOC; one block, and temporary memory
    errors     NULL; DN_UNSUPPORTED (a body without joints or parents), DN_BAD_SHAPE (a garment with more coefficients),
               DN_BAD_VALUE (not finite, a negative margin), and those of dn_rig_create and dn_garment_create
    cost       the body's rig and an association for each garment; geodesic distances where the body's model reads them
    threads    re-entrant */
DN_API dn_dressed *dn_dressed_create(const dn_dressed_desc *desc, const dn_allocator *allocator, dn_error *err);
DN_API void dn_dressed_free(dn_dressed *dressed); /* as dn_rig_free */
/*  the same without an allocator, as dn_rig_size and dn_rig_init; both sizes are upper bounds */
DN_API dn_result dn_dressed_size(const dn_dressed_desc *desc, size_t *bytes, size_t *scratch, dn_error *err);
DN_API dn_result dn_dressed_init(const dn_dressed_desc *desc, void *memory, size_t bytes, void *scratch, size_t scratch_bytes,
                                 dn_dressed **dressed, dn_error *err);

typedef struct dn_dressed_view {      /* what it holds; do not write */
   size_t vertices, joints, garments; /* of the body */
   const float *beta;                 /* (coefficients of the body) */
   const float *rest;                 /* (V,3) the body at rest in this shape, without pose offsets */
   const float *joint_rest;           /* (S,3) */
   const dn_rig *rig;                 /* the body's */
   const dn_garment *const *garment;  /* (garments) in the order of the desc */
   size_t bytes;
} dn_dressed_view;
DN_API void dn_dressed_describe(const dn_dressed *dressed, dn_dressed_view *view);

/*  dn_dressed_change - the call behind a slider: another shape, looseness or fit

    NULL leaves a thing as it is. Only what depends on the change is computed again: beta renews the body and every
    garment (and, with a model on the body, its bind: seconds where that reads geodesic distances), looseness and alpha
    the garments whose numbers differ
    scratch    dn_dressed_change_size(dressed, parallel's workers) bytes, 64-byte aligned
    errors     DN_BAD_VALUE (not finite), DN_BAD_MESH (a shape so large that it is not), DN_TOO_SMALL: as it was before.
               DN_CANCELLED and errors of the body model's bind leave it unusable until a change succeeds
    cost       13,380 body and 4,428 garment vertices, without models: beta 1.2 ms, looseness 1 ms
    threads    the only call that writes; no frame may run meanwhile */
typedef struct dn_dressed_changes {
   const float *beta;             /* (betas) as in the desc; the others are 0 */
   size_t betas;
   const float *looseness;        /* (garments) */
   const float *const *alpha;     /* (garments) each (alphas of that garment) or NULL */
   const dn_parallel *parallel;
   const dn_progress *progress;
} dn_dressed_changes;
DN_API size_t dn_dressed_change_size(const dn_dressed *dressed, unsigned workers);
DN_API dn_result dn_dressed_change(dn_dressed *dressed, const dn_dressed_changes *changes, void *scratch, size_t scratch_bytes,
                                   dn_error *err);

typedef struct dn_dressed_pose {
   const float *theta;        /* (S,3) axis-angle of every joint from its rest rotation, or NULL when rotations are given */
   const float *rotations;    /* (S,9) the same as local matrices, row-major, or NULL: from theta */
   float translation[3];      /* of the root, from its rest position */
   const float *parameters;   /* (thetas) for garment models; NULL: theta where thetas is 3 S, else zeros */
   float strength;            /* of all models, as in dn_pose. Zero-filled means 0! */
} dn_dressed_pose;
typedef struct dn_dressed_mesh { /* the body, or a garment. Arrays (V,3) may be NULL; strides in bytes, 0: 12 */
   float *positions;          size_t position_stride;
   float *normals;            size_t normal_stride;
   float bounds_min[3], bounds_max[3]; /* written */
   size_t fallback_nodes;              /* written: as in dn_output */
   dn_collision collision;             /* written: zeros for the body and where there was no collision pass */
} dn_dressed_mesh;
/*  dn_dressed_deform - one frame

    body       may be NULL; garment (garments) may be NULL: they are computed all the same
    palette    (S,12) written, or NULL: model-space transform times inverse bind, 3x4 row-major
    scratch    dn_dressed_scratch_size(dressed, workers) bytes, 64-byte aligned, one per thread or job
    returns    DN_OK, DN_NOT_FINITE as dn_deform (everything is written), DN_TOO_SMALL
    cost       the same meshes without models, one core: 16 ms, nearly all of it the collision pass
    threads    re-entrant; no allocation, no I/O, no globals; bits independent of parallel */
DN_API size_t dn_dressed_scratch_size(const dn_dressed *dressed, unsigned workers);
DN_API dn_result dn_dressed_deform(const dn_dressed *dressed, const dn_dressed_pose *pose, dn_dressed_mesh *body,
                                   dn_dressed_mesh *garment, float *palette, void *scratch, size_t scratch_bytes,
                                   const dn_parallel *parallel, dn_error *err);

/* ===================================================================================== >>blendshapes
   Neural Blend Shapes (N): from one unrigged T-pose mesh and a "neuralblendshapes" model, once per character, skin
   weights, a skeleton and corrective shapes; per frame, how much of each shape a pose asks for. First the layers, to
   compose your own, with the contract of >>layers; then dn_blend, which is all of them in order. */
#define DN_NO_EDGE 0xffffffffu

typedef struct dn_edges {  /* a mesh's edges as MeshCNN numbers them (Hanocka 2019, spec section 4) */
   size_t nodes, count;    /* N, E */
   const uint32_t *ends;   /* (E,2) smaller node first; edges in order of first appearance over triangles, corners
                              (0,1), (1,2), (2,0) */
   const uint32_t *ring;   /* (E,4) a b c d: going round the first triangle from the edge, then round the second;
                              DN_NO_EDGE where there is none */
   const uint32_t *first;  /* (N+1) */
   const uint32_t *at;     /* (2E) at[first[i]] .. at[first[i+1]-1]: the edges of node i, ascending */
   size_t skipped;         /* triangles left out */
} dn_edges;
/*  dn_edges_build - edges, four-rings and the edges of every node

    triangle   (T,3) node indices < nodes; positions (nodes,3). Skipped: triangles of exactly zero area, and those that
               would use a directed edge of an earlier kept triangle a second time; so an edge has one triangle or two
    written    ends (cap,2), ring (cap,4), first (nodes+1), at (2 cap); cap = 3 T is always enough
    skipped    NULL, or (T): the skipped triangles, ascending, as many as edges->skipped
    scratch    dn_edges_scratch(nodes, T) bytes; SIZE_MAX: does not fit */
DN_API size_t dn_edges_scratch(size_t nodes, size_t triangles);
DN_API void dn_edges_build(const float *positions, const uint32_t *triangle, size_t triangles, size_t nodes,
                           uint32_t *ends, uint32_t *ring, uint32_t *first, uint32_t *at, uint32_t *skipped,
                           dn_edges *edges, void *scratch);
/*  y_e = (v_i + v_j) / 2 over the ends of e: v (N,width) -> y (E,width) */
DN_API void dn_vertex_to_edge(const dn_edges *edges, const float *v, size_t v_stride, size_t width, float *y,
                              size_t y_stride, const dn_parallel *parallel);
/*  y_i = the mean of x_e over the edges of i, 0 when it has none: x (E,width) -> y (N,width) */
DN_API void dn_edge_to_vertex(const dn_edges *edges, const float *x, size_t x_stride, size_t width, float *y,
                              size_t y_stride, const dn_parallel *parallel);

/*  dn_meshconv - MeshCNN convolution: y_e = act(bn(W [x_e, x_a + x_c, x_b + x_d, |x_a - x_c|, |x_b - x_d|] + b)), rows of
    missing neighbours zero. The rows of five are built a tile at a time; sums of 16 terms in float are added in double. */
typedef struct dn_meshconv {
   size_t in, out;
   dn_activation activation;
   const float *panels; /* (ceil(out/16) 16, 5 in) in the order the kernels read them */
   const float *bias;   /* (ceil(out/16) 16), zero padded */
   const float *zero;   /* (64) */
   dn_kernel kernel;
} dn_meshconv;
/*  bytes for dn_meshconv_pack; 0 when a size is 0 or the product does not fit */
DN_API size_t dn_meshconv_size(size_t in, size_t out);
/*  weight (out,in,1,5); bias (out) or NULL; bn over out channels or NULL; memory 64-byte aligned, kept by the layer */
DN_API void dn_meshconv_pack(dn_meshconv *layer, size_t in, size_t out, const float *weight, const float *bias,
                             const dn_batchnorm *bn, dn_activation activation, void *memory);
/*  bytes for up to that many workers (0 counts as 1), 64-byte aligned */
DN_API size_t dn_meshconv_scratch(const dn_meshconv *layer, unsigned workers);
/*  x (E,in) -> y (E,out), strides in floats; y must not overlap x */
DN_API void dn_meshconv_ref(const dn_meshconv *layer, const dn_edges *edges, const float *x, size_t x_stride,
                            float *y, size_t y_stride);
DN_API void dn_meshconv_run(const dn_meshconv *layer, const dn_edges *edges, const float *x, size_t x_stride,
                            float *y, size_t y_stride, void *scratch, const dn_parallel *parallel);

/*  channel pool (N table 5): in place, the first channels / 5 channels become their maximum over all rows */
DN_API void dn_channel_pool(float *x, size_t x_stride, size_t rows, size_t channels, const dn_parallel *parallel);
/*  softmax over each row, in place */
DN_API void dn_edge_softmax(float *x, size_t x_stride, size_t rows, size_t width, const dn_parallel *parallel);
/*  skinning-based pooling: y_j = sum_e A_ej x_e / sum_e A_ej, a sum under 1e-10 counts as 1                N 1
    attention (E,J), x (E,width) -> y (J,width), packed; sums in double */
DN_API void dn_skinning_pool(const float *attention, size_t joints, const float *x, size_t x_stride, size_t edges,
                             size_t width, float *y, const dn_parallel *parallel);

/*  dn_skeleton_linear - skeleton-aware layer: y = act(W x + b) over the rows of all joints, joint after joint, in which a
    joint sees only those at most 2 steps from it in the tree. Only these blocks of W are kept: 122 of 24 x 24 for SMPL's
    skeleton. What W has elsewhere is not even read. Sums are taken in double. */
typedef struct dn_skeleton_linear {
   size_t joints, in, out;  /* J; widths per joint */
   dn_activation activation;
   const uint32_t *first;   /* (J+1) */
   const uint32_t *sees;    /* (first[J]) sees[first[j]] ..: the joints within 2 steps of j, itself too, ascending */
   const float *weight;     /* (out, (first[j+1]-first[j]) in) of each joint in turn; joint j's starts at out in first[j] */
   const float *bias;       /* (J out) */
} dn_skeleton_linear;
/*  parents (J), -1 for roots, else below J. 0 when a size is 0 or does not fit */
DN_API size_t dn_skeleton_linear_size(const int32_t *parents, size_t joints, size_t in, size_t out);
/*  weight (J out, J in) row-major; bias (J out) or NULL; any activation but softmax; memory is kept by the layer */
DN_API void dn_skeleton_linear_pack(dn_skeleton_linear *layer, const int32_t *parents, size_t joints, size_t in,
                                    size_t out, const float *weight, const float *bias, dn_activation activation,
                                    void *memory);
/*  x (J in) -> y (J out); y must not overlap x. The twin reads the whole matrix and skips what the tree forbids */
DN_API void dn_skeleton_linear_ref(const int32_t *parents, size_t joints, size_t in, size_t out, const float *weight,
                                   const float *bias, dn_activation activation, const float *x, float *y);
DN_API void dn_skeleton_linear_run(const dn_skeleton_linear *layer, const float *x, float *y,
                                   const dn_parallel *parallel);

/* --- a character. Immutable once made: any number of threads may pose it, each with its own scratch. */
typedef struct dn_blend dn_blend;

typedef struct dn_blend_desc {  /* borrowed during the call */
   dn_mesh mesh;                /* T-pose, in the placement and unit the model was trained on; its skin is not read */
   float weld_distance;         /* vertices at most this far apart are one node; 0: equal positions */
   const dn_parallel *parallel;
   const dn_progress *progress; /* between layers and between pieces of the wide ones */
   const dn_probe *probe;       /* NULL, or its tap sees every block by tensor name ("geo.2", "attention"), for tests:
                                   slower, and one more buffer as wide as geo2's last layer */
} dn_blend_desc;

typedef struct dn_blend_view {   /* what it holds; do not write. What it points to lives as long as the blend */
   size_t vertices, nodes, edges; /* V, N, E */
   size_t joints, shapes;        /* S, and B of every joint but the root */
   size_t bytes;
   size_t seams_welded;          /* vertices that joined an earlier one */
   size_t skipped_triangles;     /* as dn_edges_build */
   size_t isolated_nodes;        /* without edges: all on joint 0, no shapes */
   const uint32_t *node_of_vertex; /* (V) */
   const uint32_t *first_vertex; /* (N) */
   const float *rest;            /* (N,3) */
   const float *skin_weight;     /* (N,S) rows sum to one within rounding */
   const int32_t *parents;       /* (S) -1 for joint 0; parents come before children */
   const float *joint_offset;    /* (S,3) from the parent; the root's: its position */
   const float *joint_rest;      /* (S,3) positions; rest rotations are the identity */
   const float *shape;           /* (N,B,3) */
   const uint32_t *mask_first;   /* (N+1) */
   const uint32_t *mask_joint;   /* mask_joint[mask_first[i]] ..: the joints, never 0, that act on node i, ascending    N 5 */
   const char *const *joint_names; /* (S) the model's, or NULL */
} dn_blend_view;

/*  dn_blend_create - rig an unrigged mesh: weights, skeleton, shapes and masks (N 1-5)

    model      a neuralblendshapes one; must outlive the blend
    errors     NULL; DN_UNSUPPORTED (another kind of model: the text says which call takes it), DN_BAD_MESH (no
               vertices, too many to index, an index out of range, a position that is not finite), DN_BAD_VALUE
               (weld_distance; or what came out is not finite), DN_CANCELLED, DN_NO_MEMORY: nothing is kept. A mesh
               without edges is legal: all on joint 0
    cost       full size: 2.7 M multiplications an edge, three edges a vertex
    memory     full size, closed mesh of 12,000 vertices: 98 MB while it runs, beside the model; 4 MB kept. Layer by layer over
               all edges, so two rows of 256 and a slice of 64 channels an edge; rows of 512 + 24 are never whole
    threads    re-entrant; the same bits for every desc->parallel */
DN_API dn_blend *dn_blend_create(const dn_model *model, const dn_blend_desc *desc, const dn_allocator *allocator,
                                 dn_error *err);
/*  after the last frame; NULL is allowed; does nothing to one made by dn_blend_init, whose memory is yours */
DN_API void dn_blend_free(dn_blend *blend);
/*  dn_blend_size, dn_blend_init - the same without an allocator

    bytes      kept; scratch is needed during dn_blend_init only. Both are bounds from the counts: 3 T edges, of which a
               closed mesh has half
    memory     both 64-byte aligned; memory must outlive the blend, *blend lies inside it
    errors     as dn_blend_create; DN_TOO_SMALL names both sizes; *blend is NULL then */
DN_API dn_result dn_blend_size(const dn_model *model, const dn_blend_desc *desc, size_t *bytes, size_t *scratch,
                               dn_error *err);
DN_API dn_result dn_blend_init(const dn_model *model, const dn_blend_desc *desc, void *memory, size_t bytes,
                               void *scratch, size_t scratch_bytes, dn_blend **blend, dn_error *err);
/*  fills *view. Re-entrant, cannot fail */
DN_API void dn_blend_describe(const dn_blend *blend, dn_blend_view *view);

/*  dn_blend_coefficients - alpha_ij of a pose: per joint but the root, an MLP on its local rotation minus the identity

    rotations     (S,9) local, row-major
    coefficients  (S-1,B): row J is joint J+1
    scratch       dn_blend_scratch_size bytes, 64-byte aligned
    threads       re-entrant; no allocation, as everything below */
DN_API void dn_blend_coefficients(const dn_blend *blend, const float *rotations, float *coefficients, void *scratch);
/*  sum_j sum_i alpha_ij m_j B_i of every vertex (N 5), rest space: -> displacement (V,3), stride in bytes, 0: 12 */
DN_API void dn_blend_displace(const dn_blend *blend, const float *coefficients, float *displacement, size_t stride,
                              const dn_parallel *parallel);
/*  m_j B_i as a morph target: what coefficient row joint - 1, column shape weighs. offsets (V,3), stride in bytes, 0: 12;
    returns how many vertices it moves; offsets NULL: only that */
DN_API size_t dn_blend_morph(const dn_blend *blend, size_t joint, size_t shape, float *offsets, size_t stride);

typedef struct dn_blend_input {
   const float *rotations;     /* (S,9) local, row-major, or NULL: */
   const float *axis_angle;    /* (S,3) local; both NULL: the rest pose */
   const float *translation;   /* (3) moves the character as a whole, or NULL */
   const float *coefficients;  /* (S-1,B), or NULL: dn_blend_coefficients of the rotations */
   float strength;             /* 0 plain skinning .. 1 the full displacement; clamped. Zero-filled means 0! */
} dn_blend_input;
typedef struct dn_blend_output { /* any pointer may be NULL; strides in bytes, 0: 12 */
   float *positions;     size_t position_stride;     /* (V,3) */
   float *displacement;  size_t displacement_stride; /* (V,3) times strength, rest space: before skinning */
   float *coefficients;  /* (S-1,B) */
   float *palette;       /* (S,12) 3x4 row-major: joint transform times inverse bind */
} dn_blend_output;
/*  dn_blend_pose - one frame: coefficients, displacement, LBS with the predicted weights and skeleton

    scratch    dn_blend_scratch_size(blend) bytes, 64-byte aligned
    returns    DN_OK; DN_NOT_FINITE when a rotation or coefficient was not (the identity, or 0, stands in: the output is
               written in full); DN_TOO_SMALL: nothing is written
    equation   p = sum_s w_s P_s [v + strength sum_j sum_i alpha_ij m_j B_i; 1] + translation                     N 2, 3, 5
    threads    re-entrant; no allocation; bits independent of parallel */
DN_API dn_result dn_blend_pose(const dn_blend *blend, const dn_blend_input *in, const dn_blend_output *out,
                               void *scratch, size_t scratch_bytes, const dn_parallel *parallel, dn_error *err);
DN_API size_t dn_blend_scratch_size(const dn_blend *blend);
/*  the same as an allocated block, given back by dn_scratch_free(scratch, *bytes, allocator); NULL and DN_NO_MEMORY */
DN_API void *dn_blend_scratch_create(const dn_blend *blend, const dn_allocator *allocator, size_t *bytes,
                                     dn_error *err);
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
   #ifdef DN_EXACT /* no two libms agree on these; on roots they do */
      #define DN__OWN_SINE
      #define DN_SINF(x) dn__sine((double)(x), 0.0)
      #define DN_COSF(x) dn__sine((double)(x), 0.5)
   #else
      #define DN_SINF(x) sinf(x)
      #define DN_COSF(x) cosf(x)
   #endif
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

/* --- DN_EXACT: the same bits everywhere. The reference texts alone, whose order is fixed; every operation rounded to
   its own type and by itself: a b + c in one rounding is what compilers make of it where the processor can, unless told
   not to. gcc's pragma is undone at the end of the file; the others' holds on, which rounds no code after it worse.
   Refused where a compiler says that it takes liberties. clang does not say so of parts of -ffast-math, nor that
   -ffp-contract=fast disregards the source: do not give it these. A thread that flushes denormals to zero, or rounds
   otherwise than to nearest, gets other bits; so do replacements like DN_SINF that are not exact themselves. The one
   thing left to the processor is which NaN a NaN is. */
#ifdef DN_EXACT
   #include <float.h>
   #if !defined(FLT_EVAL_METHOD) || (FLT_EVAL_METHOD != 0 && FLT_EVAL_METHOD != 16)
      #error "deformnet: DN_EXACT needs floats that round as floats: 32-bit x86 has them with -msse2 -mfpmath=sse, gcc for s390x with -std=gnu99"
   #endif
   #if defined(__FAST_MATH__) || defined(_M_FP_FAST) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__) || \
       (defined(__GCC_IEC_559) && __GCC_IEC_559 < 1)
      #error "deformnet: DN_EXACT and -ffast-math, or parts of it, exclude each other"
   #endif
   #ifndef DN_NO_SIMD
      #define DN_NO_SIMD
      #define DN__NO_SIMD /* ours: it goes again at the end */
   #endif
   #if defined(__GNUC__) && !defined(__clang__)
      #pragma GCC push_options
      #pragma GCC optimize("fp-contract=off")
   #elif defined(_MSC_VER) && !defined(__clang__)
      #pragma fp_contract(off)
   #else
      #pragma STDC FP_CONTRACT OFF
   #endif
#endif
#ifdef DN__OWN_SINE
/* sin x, or cos x when half is 1/2: with n the whole number nearest to x / pi - half and r = x - (n + half) pi,
   sin x = (-1)^n sin r and cos x = -(-1)^n sin r; sin r is its series up to r^15. Within an ulp or two of the float */
static float dn__sine(double x, double half)
{
   double n, r, z;
   int64_t k;
   if (!(x > -1e9 && x < 1e9)) return (float)(x - x); /* NaN of NaN and infinity; 0 where a float knows no angle any more */
   n = x * 0.31830988618379067 - half;
   k = (int64_t)(n < 0 ? n - 0.5 : n + 0.5);
   n = (double)k + half;
   r = (x - n * 3.140625) - n * 9.6765358979323846e-4; /* pi in two parts: the first product is exact */
   z = r * r;
   r += r * z * (-1.0 / 6 + z * (1.0 / 120 + z * (-1.0 / 5040 + z * (1.0 / 362880 + z * (-1.0 / 39916800 + z *
        (1.0 / 6227020800.0 - z / 1307674368000.0))))));
   return (float)((k & 1) != (half > 0) ? -r : r);
}
#endif

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
   char tiny[16], dtype[16], line[240];
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
      if (!dn__json_string(j, "\"dtype\", \"shape\" or \"data_offsets\"", tiny, sizeof tiny, &n)) return 0;
      for (k = 0; k < 3 && strcmp(tiny, keys[k]) != 0; k++) {}
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
   char tiny[16];
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
         char *name = t ? t->text + need->text : tiny;
         dn_tensor tensor;
         j.kind = NULL;
         dn__json_space(&j);
         j.name_at = j.at + 1;
         if (!dn__json_string(&j, "a tensor name in quotes", name, t ? t->text_size - need->text : sizeof tiny, &n))
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

/* --- progress inside a loop: work counts what was done since the callback was asked last. Non-zero: cancelled */
#ifndef DN__TICK
   #define DN__TICK ((size_t)1 << 14) /* steps of some ten nanoseconds */
#endif
static int dn__ask(const dn_progress *p, const char *stage, double done, size_t *work)
{
   if (*work < DN__TICK) return 0;
   *work = 0;
   return p && p->step && p->step(p->user, stage, (float)done) != 0;
}

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
/* dn_weld; SIZE_MAX when cancelled */
static size_t dn__weld(const float *positions, size_t vertices, const uint32_t *joints, const float *weights, size_t influences,
                       float distance, uint32_t *node_of_vertex, uint32_t *first_vertex, size_t *apart, void *scratch,
                       const dn_progress *progress)
{
   dn__arena arena = dn__arena_of(scratch, SIZE_MAX);
   dn__weld_grid grid = dn__weld_layout(&arena, vertices);
   double reach = distance > 0.0f ? (double)distance : 0.0;
   double cell = reach * 1.0001; /* the hair covers the rounding of position / cell */
   size_t nodes = 0, left_apart = 0, work = 0, v;
   DN_ASSERT(vertices < DN__NONE && scratch && node_of_vertex && first_vertex);
   memset(grid.head, 0xff, (grid.mask + 1) * sizeof *grid.head);

   for (v = 0; v < vertices; v++) {
      const float *p = positions + 3 * v;
      double home[3];
      uint32_t best = DN__NONE;
      int seen_apart = 0, k, around = reach > 0.0 ? 27 : 1;
      size_t home_bucket;
      if (dn__ask(progress, "weld", (double)v / (double)vertices, &work)) return SIZE_MAX;
      for (k = 0; k < 3; k++) home[k] = reach > 0.0 ? dn__floor((double)p[k] / cell) : (double)p[k];
      home_bucket = dn__hash3(home) & grid.mask;

      for (k = 0; k < around; k++, work++) {
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
         for (n = grid.head[bucket]; n != DN__NONE && n < best; n = grid.next[n], work++) {
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
DN_API size_t dn_weld(const float *positions, size_t vertices, const uint32_t *joints, const float *weights,
                      size_t influences, float distance, uint32_t *node_of_vertex, uint32_t *first_vertex, size_t *apart,
                      void *scratch)
{
   return dn__weld(positions, vertices, joints, weights, influences, distance, node_of_vertex, first_vertex, apart, scratch, NULL);
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
/* dn_graph_build; non-zero when cancelled */
static int dn__graph_build(const uint32_t *triangle, size_t triangles, size_t nodes, uint32_t *first, uint32_t *next,
                           dn_graph *g, void *scratch, const dn_progress *progress)
{
   dn__arena arena = dn__arena_of(scratch, SIZE_MAX);
   uint32_t *cursor = (uint32_t *)dn__take(&arena, nodes + 1, sizeof(uint32_t));
   uint32_t *loose = (uint32_t *)dn__take(&arena, 6 * triangles, sizeof(uint32_t)); /* neighbours, unsorted, repeated */
   uint32_t total = 0;
   size_t t, i, from, e, work = 0;
   int c;
   DN_ASSERT(nodes < DN__NONE && triangles < DN__NONE / 6);

   memset(first, 0, (nodes + 1) * sizeof *first);
   for (t = 0; t < triangles; t++, work++) {
      if (dn__ask(progress, "graph", 0.25 * (double)t / (double)triangles, &work)) return 1;
      for (c = 0; c < 3; c++) {
         uint32_t a = triangle[3 * t + (size_t)c], b = triangle[3 * t + (size_t)(c == 2 ? 0 : c + 1)];
         DN_ASSERT(a < nodes);
         if (a != b) first[a]++, first[b]++;
      }
   }
   for (i = 0; i < nodes; i++) { /* counts -> row starts */
      uint32_t count = first[i];
      cursor[i] = first[i] = total;
      total += count;
   }
   first[nodes] = total;
   for (t = 0; t < triangles; t++, work++) {
      if (dn__ask(progress, "graph", 0.25 + 0.25 * (double)t / (double)triangles, &work)) return 1;
      for (c = 0; c < 3; c++) {
         uint32_t a = triangle[3 * t + (size_t)c], b = triangle[3 * t + (size_t)(c == 2 ? 0 : c + 1)];
         if (a != b) loose[cursor[a]++] = b, loose[cursor[b]++] = a;
      }
   }
   memcpy(cursor, first, nodes * sizeof *first);
   for (i = 0; i < nodes; i++) { /* transpose; a repeat follows its twin directly */
      if (dn__ask(progress, "graph", 0.5 + 0.25 * (double)i / (double)nodes, &work)) return 1;
      for (e = first[i]; e < first[i + 1]; e++, work++) next[cursor[loose[e]]++] = (uint32_t)i;
   }

   total = 0; /* drop the repeats, rows sliding down in place */
   from = 0;
   for (i = 0; i < nodes; i++) {
      size_t end = first[i + 1];
      uint32_t start = total;
      if (dn__ask(progress, "graph", 0.75 + 0.25 * (double)i / (double)nodes, &work)) return 1;
      for (e = from; e < end; e++, work++)
         if (total == start || next[total - 1] != next[e]) next[total++] = next[e];
      first[i] = start;
      from = end;
   }
   first[nodes] = total;
   g->nodes = nodes;
   g->first = first;
   g->next = next;
   return 0;
}
DN_API void dn_graph_build(const uint32_t *triangle, size_t triangles, size_t nodes, uint32_t *first, uint32_t *next,
                           dn_graph *g, void *scratch)
{
   (void)dn__graph_build(triangle, triangles, nodes, first, next, g, scratch, NULL);
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

/* --- an order of the nodes in which neighbours are near: level by level from one end of each component to the other
   (Cuthill & McKee 1969). The end is found by walking to a far node and on from there while that
   takes more levels (Gibbs, Poole, Stockmeyer 1976). */
static size_t dn__graph_bandwidth(const dn_graph *g) /* the largest |i - j| over all edges */
{
   size_t i, most = 0;
   for (i = 0; i < g->nodes; i++) {
      uint32_t from = g->first[i], to = g->first[i + 1];
      if (from == to) continue;
      if (g->next[from] < i) most = dn__max(most, i - g->next[from]); /* ascending: the first and the last are farthest */
      if (g->next[to - 1] > i) most = dn__max(most, g->next[to - 1] - i);
   }
   return most;
}
/* floods from `root`: its component to order, level by level; mark of what was met becomes `now`. Returns how many nodes,
   the number of levels, and where the last one starts */
static size_t dn__levels(const dn_graph *g, uint32_t root, uint32_t *order, uint32_t *mark, uint32_t now, size_t *levels,
                         size_t *last)
{
   size_t head = 0, tail = 1, end;
   order[0] = root;
   mark[root] = now;
   for (*levels = 0; head < tail; ++*levels)
      for (*last = head, end = tail; head < end; head++) {
         uint32_t n = order[head], e;
         for (e = g->first[n]; e < g->first[n + 1]; e++)
            if (mark[g->next[e]] != now) mark[g->next[e]] = now, order[tail++] = g->next[e];
      }
   return tail;
}
/* place (N): node i becomes place[i]; order (N): scratch */
static void dn__graph_near(const dn_graph *g, uint32_t *place, uint32_t *order)
{
   enum { WALKS = 6 }; /* longer ones gained nothing on any character; a hostile mesh must not ask for N of them */
   size_t i, at = 0, count, levels, more, last, k;
   uint32_t now = 0, *mark = place;
   memset(mark, 0, g->nodes * sizeof *mark);
   for (i = 0; i < g->nodes; i++) {
      uint32_t end;
      if (mark[i]) continue;
      count = dn__levels(g, (uint32_t)i, order + at, mark, ++now, &levels, &last);
      for (k = 0; k < WALKS && count > 1; k++) { /* on from the node of fewest neighbours in the last level */
         uint32_t *l = order + at + last;
         size_t n, few = SIZE_MAX;
         for (end = *l, n = 0; n < count - last; n++)
            if (g->first[l[n] + 1] - g->first[l[n]] < few) end = l[n], few = g->first[end + 1] - g->first[end];
         dn__levels(g, end, order + at, mark, ++now, &more, &last);
         if (more <= levels) break;
         levels = more;
      }
      at += count;
   }
   for (i = 0; i < g->nodes; i++) place[order[i]] = (uint32_t)i;
}

static double dn__dot3(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
static void dn__cross3(const double a[3], const double b[3], double out[3])
{
   out[0] = a[1] * b[2] - a[2] * b[1];
   out[1] = a[2] * b[0] - a[0] * b[2];
   out[2] = a[0] * b[1] - a[1] * b[0];
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
/* The same for what the network reads, in double: in a folded fan the cross products nearly cancel. On a body of 10,242
   nodes plain floats were off by up to 4e-5, this by 1e-7. */
static void dn__fine_normal(const double sum[3], float normal[3])
{
   double length = DN_SQRT(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]);
   double scale = length >= 1e-18 && dn__finite((float)length) ? 1.0 / length : 0.0;
   int k;
   for (k = 0; k < 3; k++) normal[k] = scale > 0.0 ? (float)(sum[k] * scale) : 0.0f;
}
static void dn__normals_fine_range(const double *positions, const uint32_t *triangle, const uint32_t *corner_first,
                                   const uint32_t *corner_tri, size_t begin, size_t end, float *normals)
{
   size_t i, e, k;
   for (i = begin; i < end; i++) {
      double sum[3] = { 0.0, 0.0, 0.0 };
      for (e = corner_first[i]; e < corner_first[i + 1]; e++) {
         const uint32_t *t = triangle + 3 * (size_t)corner_tri[e];
         const double *p = positions + 3 * (size_t)t[0], *q = positions + 3 * (size_t)t[1], *r = positions + 3 * (size_t)t[2];
         double u[3], v[3];
         for (k = 0; k < 3; k++) u[k] = q[k] - p[k], v[k] = r[k] - p[k];
         sum[0] += u[1] * v[2] - u[2] * v[1];
         sum[1] += u[2] * v[0] - u[0] * v[2];
         sum[2] += u[0] * v[1] - u[1] * v[0];
      }
      dn__fine_normal(sum, normals + 3 * i);
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
/* R^T p: into the frame that the rotation r is of; out may not be p */
static void dn__unrotate(const float r[9], const double p[3], double out[3])
{
   int k;
   for (k = 0; k < 3; k++) out[k] = (double)r[k] * p[0] + (double)r[3 + k] * p[1] + (double)r[6 + k] * p[2];
}
/* LBS of nodes begin..end, turned back by `root` and not rounded. rest (N,3); node i's joints and weights are row
   vertex[i] of (V,I) */
static void dn__framed_lbs(const float *rest, const uint32_t *joint, const float *weight, size_t influences,
                           const uint32_t *vertex, const float *palette, const float root[9], size_t begin, size_t end,
                           double *out)
{
   size_t i;
   for (i = begin; i < end; i++) {
      size_t v = vertex[i];
      double p[3];
      dn__lbs_point(joint + influences * v, weight + influences * v, influences, palette, rest + 3 * i, p);
      dn__unrotate(root, p, out + 3 * i);
   }
}
/* points begin..end; row v of joint and weight belongs to point v. >>lbs has the fast texts, and dn_lbs */
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
static void dn__rows_position(const double *positions, size_t begin, size_t end, float *rows, size_t stride)
{
   size_t i, k;
   for (i = begin; i < end; i++)
      for (k = 0; k < 3; k++) rows[i * stride + k] = (float)positions[3 * i + k];
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
/* where the joints are now: P_s [joint at rest; 1]; joint s of the model is map[s] in the palette, or s when map is NULL.
   posed (3,pitch): all x, all y, all z, so that the fast texts load joints side by side */
static size_t dn__posed_pitch(size_t joints) { return dn__round(joints, 16); }
static void dn__posed_joints(const float *palette, const uint32_t *map, const float *joint_rest, size_t joints, float *posed)
{
   size_t s, k, pitch = dn__posed_pitch(joints);
   for (s = 0; s < pitch; s++) {
      float p[3] = { 0.0f, 0.0f, 0.0f };
      if (s < joints) dn__transform(palette + 12 * (size_t)(map ? map[s] : s), joint_rest + 3 * s, p);
      for (k = 0; k < 3; k++) posed[k * pitch + s] = p[k];
   }
}
/* |p_i - posed_s| for every joint (C 4.4) */
static void dn__rows_distance(const double *positions, const float *posed, size_t joints, size_t begin, size_t end,
                              float *rows, size_t stride)
{
   size_t i, s, pitch = dn__posed_pitch(joints);
   for (i = begin; i < end; i++) {
      float px = (float)positions[3 * i], py = (float)positions[3 * i + 1], pz = (float)positions[3 * i + 2];
      float *row = rows + i * stride;
      for (s = 0; s < joints; s++) {
         float x = px - posed[s], y = py - posed[pitch + s], z = pz - posed[2 * pitch + s];
         row[s] = DN_SQRTF(x * x + y * y + z * z);
      }
   }
}
/* x -> (x - mean) / std of whole rows, 1 / std as two floats: nothing is rounded that a division would not */
static void dn__normalise_range(const float *mean, const float *scale, const float *rest, size_t width, float *rows,
                                size_t begin, size_t end)
{
   size_t i, k;
   for (i = begin; i < end; i++)
      for (k = 0; k < width; k++) {
         float x = rows[i * width + k] - mean[k];
         rows[i * width + k] = x * scale[k] + x * rest[k];
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
/* Everything the outside cannot reach by faces is solid; then ids. Cells with a node are solid even without a triangle.
   Non-zero when cancelled */
static int dn__voxelise(dn__voxels *v, const float *positions, size_t nodes, const uint32_t *triangle, size_t triangles,
                        const dn_progress *progress, const char *stage)
{
   size_t stride[3], i, k, head = 0, tail = 0, c[3], block[3], work = 0;
   uint32_t *queue = v->id_of; /* not yet in use */
   stride[0] = 1;
   stride[1] = v->n[0];
   stride[2] = v->n[0] * v->n[1];
   memset(v->solid, 0, v->cells);
   for (i = 0; i < triangles; i++, work += 8) {
      if (dn__ask(progress, stage, 0.0, &work)) return 1;
      dn__mark_triangle(v, positions, triangle + 3 * i);
   }
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
      if (work++, dn__ask(progress, stage, 0.0, &work)) return 1;
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
            if (work += 64, dn__ask(progress, stage, 0.0, &work)) return 1;
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
   return 0;
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
   if (dn__voxelise(v, job->mesh.positions, job->mesh.nodes, job->mesh.triangle, job->mesh.triangles, progress, stage)) return DN_CANCELLED;
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
   in       rows x (rows,in) with a stride; weights in panels (ceil(out/16), in, 16)    out  y = act(bn(x W^T + b))
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
static float dn__narrow(double x) /* to float; what does not fit saturates (a conversion would be undefined) */
{
   return x > 3.4028234e38 ? 3.4028234e38f : x < -3.4028234e38 ? -3.4028234e38f : (float)x;
}
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
   3e-7); above, from tanh |x| = 1 - q, q = 2t / (1 + t), t = exp(-2|x|), as (|x| - 1) + q: up to 2 that difference is
   exact. tanh is taken from the same two: absolute error below 1e-7, odd, exactly 0 at 0 and 1 from 9.1 on. */
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
static float dn__tanh_rest(float size) /* 1 - tanh x, x = size >= 0 */
{
   float t = dn__exp(-2.0f * size);
   return 2.0f * t / (1.0f + t);
}
static float dn__tanh(float x)
{
   float size = DN_FABSF(x), y;
   if (size < DN__TANH_SMALL) return x - dn__shrink_small(x);
   y = 1.0f - dn__tanh_rest(size);
   return x < 0 ? -y : y;
}
static float dn__tanhshrink(float x)
{
   float size = DN_FABSF(x), y;
   if (size < DN__TANH_SMALL) return dn__shrink_small(x);
   y = (size - 1.0f) + dn__tanh_rest(size);
   return x < 0 ? -y : y;
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

/* y_ro = act(bn( sum_c x_rc W_oc + b_o ) + add_ro), rows begin to end - 1, with bn(u) = (u - mean) scale + shift. A column has
   five numbers (none, columns == NULL: the plain sum):

        start, start_rest    b - mean, as two floats
        scale, scale_rest    weight / sqrt(var + 1e-5), as two floats
        shift                the batch norm's bias

   W stays what the file has, and no constant is rounded. Folded into W and b, every weight would be: wrong the same
   way at every node, and twenty layers of attention amplified that more than anything else. Here products are exact
   and sums in double: the fast texts are measured against this one. */
#define DN__COLUMN ((size_t)5 * DN_PANEL) /* floats a panel has of these: start (16), start_rest (16), ... */
static void dn__product_ref(const dn_linear *l, const float *x, size_t x_stride, float *y, size_t y_stride,
                            size_t begin, size_t end)
{
   size_t r, o, c;
   for (r = begin; r < end; r++) {
      const float *row = x + r * x_stride; /* (in) */
      float *to = y + r * y_stride;        /* (out) */
      for (o = 0; o < l->out; o++) {
         const float *w = l->panels + (o / DN_PANEL * l->in) * DN_PANEL + o % DN_PANEL; /* W_oc at w[16 c] */
         double sum = 0, scale = 1, shift = 0;
         if (l->columns) {
            const float *n = l->columns + o / DN_PANEL * DN__COLUMN + o % DN_PANEL; /* its five numbers at n[16 k] */
            sum = (double)n[0] + (double)n[DN_PANEL];
            scale = (double)n[2 * DN_PANEL] + (double)n[3 * DN_PANEL];
            shift = (double)n[4 * DN_PANEL];
         }
         for (c = 0; c < l->in; c++) sum += (double)row[c] * (double)w[c * DN_PANEL];
         sum = sum * scale + shift;
         if (l->add) sum += (double)l->add[r * l->out + o];
         to[o] = dn__activate(dn__narrow(sum), l->activation);
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
      #define DN__TARGET_AVX2_UNFUSED
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
         #define DN__TARGET_AVX2 __attribute__((target("avx2,fma,f16c")))
         #define DN__TARGET_AVX2_UNFUSED __attribute__((target("avx2"))) /* gcc fuses intrinsics where it may */
         #if defined(__x86_64__) /* the 32 registers that its tile fills exist in 64-bit mode only */
            #define DN__HAS_AVX512
            #define DN__TARGET_AVX512 __attribute__((target("avx2,fma,f16c,avx512f,avx512vl,avx512dq,avx512bw")))
            #if (defined(__clang__) && __clang_major__ >= 9) || (!defined(__clang__) && __GNUC__ >= 10)
               #define DN__HAS_VNNI /* and bfloat16 products; beside the kernel, asked for on their own */
               #define DN__TARGET_VNNI __attribute__((target("avx2,fma,f16c,avx512f,avx512vl,avx512dq,avx512bw,avx512vnni")))
               #define DN__TARGET_BF16 __attribute__((target("avx2,fma,f16c,avx512f,avx512vl,avx512dq,avx512bw,avx512bf16")))
            #endif
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

/* Rounding of a float sum grows with its length: 504 terms one after another lost more than all the rest of an
   eighteen-block network. So DN__RUN terms are added up at a time, and each run to a total kept beside:

        total' = total + run,   next run starts from (total - total') + run

   what the addition lost goes into the next run (Kahan), and only the short runs round. Shorter still where that is
   cheap (AVX-512) or the products round too (no fused multiply-add). */
#define DN__RUN ((size_t)16)
#define DN__RUN_SHORT ((size_t)8)
/* Where totals are kept in memory, compilers that see what was stored a run ago would hold it in registers, and there
   are none left; nor for the weights of four terms, loaded early. */
#if defined(__GNUC__) || defined(__clang__)
   #define DN__IN_MEMORY() __asm__ __volatile__("" : : : "memory")
#else
   #define DN__IN_MEMORY() (void)0
#endif
#if defined(__GNUC__) || defined(__clang__)
   #define DN__SOON(p) __builtin_prefetch(p, 1) /* will be written */
#elif defined(DN__HAS_AVX2)
   #define DN__SOON(p) _mm_prefetch((const char *)(p), _MM_HINT_T0)
#else
   #define DN__SOON(p) (void)(p)
#endif
/* Each text offers these. A tile is some rows of x times one panel of weights, or two side by side; every y adds its
   terms c = 0 .. in-1 in an order that only its column decides, so results do not depend on how rows are grouped. */
typedef struct dn__target { float *at; size_t stride; } dn__target; /* where a tile puts the 16 columns of a panel */
typedef struct dn__tile {
   size_t rows; /* 0: there is none */
   /* y (rows,16) = bn(x (rows,in) w + b), one for each panel; w (panels,in,16); columns (panels,5,16), as in
      dn__product_ref; total: room for (rows,16 panels) */
   void (*run)(const float *x, size_t x_stride, size_t in, const float *w, const float *columns, float *total,
               const dn__target *y);
} dn__tile;
typedef struct dn__kernel {
   dn__tile one, two; /* panels */
   /* to (rows,columns) = act(from); from's rows are a multiple of 16 wide; not softmax */
   void (*activate)(const float *from, size_t from_stride, float *to, size_t to_stride, size_t rows, size_t columns,
                    dn_activation activation);
   /* >>attention: dn__attend_ref is the specification */
   void (*attend)(const dn_gat *b, const dn_graph *g, const float *z, size_t mask, float *y, size_t y_stride,
                  size_t begin, size_t end);
} dn__kernel;
#define DN__TILE_ROWS 14 /* the highest */
static DN__INLINE float *dn__cache_line(float *p) /* the first 64-byte boundary from p on, at most 15 floats away */
{
   return p + ((16 - ((size_t)(uintptr_t)p >> 2 & 15)) & 15);
}
#define DN__EACH3(X) X(0) X(1) X(2)
#define DN__EACH6(X) DN__EACH3(X) X(3) X(4) X(5)
#define DN__EACH7(X) DN__EACH6(X) X(6)
#define DN__EACH14(X) DN__EACH7(X) X(7) X(8) X(9) X(10) X(11) X(12) X(13)

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
   __m256 size = _mm256_andnot_ps(sign, x), z = _mm256_mul_ps(x, x), s, t, tiny;
   tiny = _mm256_cmp_ps(size, _mm256_set1_ps(DN__TANH_SMALL), _CMP_LT_OQ);
   s = _mm256_fmadd_ps(_mm256_set1_ps(DN__TANH_4), z, _mm256_set1_ps(DN__TANH_3));
   s = _mm256_fmadd_ps(s, z, _mm256_set1_ps(DN__TANH_2));
   s = _mm256_fmadd_ps(s, z, _mm256_set1_ps(DN__TANH_1));
   s = _mm256_fmadd_ps(s, z, _mm256_set1_ps(DN__TANH_0));
   s = _mm256_mul_ps(_mm256_mul_ps(s, z), x); /* x - tanh x, small x */
   t = dn__exp_avx2(_mm256_mul_ps(size, _mm256_set1_ps(-2.0f)));
   t = _mm256_div_ps(_mm256_add_ps(t, t), _mm256_add_ps(one, t)); /* 1 - tanh |x| */
   t = shrink ? _mm256_add_ps(_mm256_sub_ps(size, one), t) : _mm256_sub_ps(one, t);
   t = _mm256_or_ps(t, _mm256_and_ps(sign, x)); /* large x */
   return _mm256_blendv_ps(t, shrink ? s : _mm256_sub_ps(x, s), tiny);
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
DN__TARGET_AVX2 static DN__INLINE __m256i dn__lanes_avx2(size_t count) /* the first `count` of 8 */
{
   const __m256i lane = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
   return _mm256_cmpgt_epi32(_mm256_set1_epi32(count < 8 ? (int)count : 8), lane);
}
DN__TARGET_AVX2 static void dn__activate_avx2(const float *from, size_t from_stride, float *to, size_t to_stride,
                                              size_t rows, size_t columns, dn_activation activation)
{
   size_t c;
   for (; rows > 0; rows--, from += from_stride, to += to_stride) {
      for (c = 0; c + 8 <= columns; c += 8)
         _mm256_storeu_ps(to + c, dn__act_avx2(_mm256_loadu_ps(from + c), activation));
      if (c < columns)
         _mm256_maskstore_ps(to + c, dn__lanes_avx2(columns - c), dn__act_avx2(_mm256_loadu_ps(from + c), activation));
   }
}
DN__TARGET_AVX2 static DN__INLINE __m256 dn__start_avx2(const float *columns, size_t at)
{
   return columns ? _mm256_loadu_ps(columns + at) : _mm256_setzero_ps();
}
/* the sum of a run joins the total; returns what the next run starts from */
DN__TARGET_AVX2 static DN__INLINE __m256 dn__carry_avx2(float *total, __m256 run)
{
   __m256 before = _mm256_loadu_ps(total), after = _mm256_add_ps(before, run);
   _mm256_storeu_ps(total, after);
   return _mm256_add_ps(_mm256_sub_ps(before, after), run);
}
DN__TARGET_AVX2 static DN__INLINE __m256 dn__bn_avx2(__m256 sum, __m256 scale, __m256 rest, __m256 shift)
{
   return _mm256_fmadd_ps(sum, scale, _mm256_fmadd_ps(sum, rest, shift)); /* (scale + rest) sum + shift */
}
/* 6 rows x 16 columns: 12 sums, 2 weights and 1 broadcast x fill 15 of the 16 registers */
DN__TARGET_AVX2 static void dn__tile_avx2(const float *x, size_t x_stride, size_t in, const float *w,
                                          const float *columns, float *total, const dn__target *y)
{
   const float *x0 = x, *x3 = x + 3 * x_stride;
   __m256 w0, w1, v;
   size_t c, end;
   w0 = dn__start_avx2(columns, 0);
   w1 = dn__start_avx2(columns, 8);
#define DN__START(r)                                                                                         \
   __m256 a##r = dn__start_avx2(columns, DN_PANEL), b##r = dn__start_avx2(columns, DN_PANEL + 8);            \
   _mm256_storeu_ps(total + r * DN_PANEL, w0);                                                               \
   _mm256_storeu_ps(total + r * DN_PANEL + 8, w1);
#define DN__STEP(r)                                                                                          \
   v = _mm256_broadcast_ss((r < 3 ? x0 : x3) + r % 3 * x_stride + K);                                        \
   a##r = _mm256_fmadd_ps(v, w0, a##r);                                                                      \
   b##r = _mm256_fmadd_ps(v, w1, b##r);
#define DN__TERM(k)                                                                                          \
   {                                                                                                         \
      enum { K = k };                                                                                        \
      DN__IN_MEMORY();                                                                                       \
      w0 = _mm256_loadu_ps(w + K * DN_PANEL);                                                                \
      w1 = _mm256_loadu_ps(w + K * DN_PANEL + 8);                                                            \
      DN__EACH6(DN__STEP)                                                                                    \
   }
#define DN__CARRY(r)                                                                                         \
   a##r = dn__carry_avx2(total + r * DN_PANEL, a##r);                                                        \
   b##r = dn__carry_avx2(total + r * DN_PANEL + 8, b##r);
#define DN__SUM(r)                                                                                           \
   a##r = _mm256_add_ps(_mm256_loadu_ps(total + r * DN_PANEL), a##r);                                        \
   b##r = _mm256_add_ps(_mm256_loadu_ps(total + r * DN_PANEL + 8), b##r);
#define DN__BN(r) a##r = dn__bn_avx2(a##r, w0, w1, v);
#define DN__BN2(r) b##r = dn__bn_avx2(b##r, w0, w1, v);
#define DN__STORE(r)                                                                                         \
   _mm256_storeu_ps(y->at + r * y->stride, a##r);                                                            \
   _mm256_storeu_ps(y->at + r * y->stride + 8, b##r);
   {
      DN__EACH6(DN__START)
      for (c = 0; c < in;) {
         end = dn__min(in, c + DN__RUN);
         for (; c + 4 <= end; c += 4, w += 4 * DN_PANEL, x0 += 4, x3 += 4) {
            DN__TERM(0) DN__TERM(1) DN__TERM(2) DN__TERM(3)
         }
         for (; c < end; c++, w += DN_PANEL, x0++, x3++) DN__TERM(0)
         DN__IN_MEMORY();
         DN__EACH6(DN__CARRY)
      }
      DN__EACH6(DN__SUM)
      if (columns) {
         w0 = _mm256_loadu_ps(columns + 2 * DN_PANEL);
         w1 = _mm256_loadu_ps(columns + 3 * DN_PANEL);
         v = _mm256_loadu_ps(columns + 4 * DN_PANEL);
         DN__EACH6(DN__BN)
         w0 = _mm256_loadu_ps(columns + 2 * DN_PANEL + 8);
         w1 = _mm256_loadu_ps(columns + 3 * DN_PANEL + 8);
         v = _mm256_loadu_ps(columns + 4 * DN_PANEL + 8);
         DN__EACH6(DN__BN2)
      }
      DN__EACH6(DN__STORE)
   }
#undef DN__START
#undef DN__STEP
#undef DN__TERM
#undef DN__CARRY
#undef DN__SUM
#undef DN__BN
#undef DN__BN2
#undef DN__STORE
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
/* tanh from a table, half the work: 16 registers' lanes hold 16 polynomials in |x| - middle, of x - tanh x below 0.75 and
   of 1 - tanh x above, for |x| in [0, 3/32), [3/32, 1/8), [1/8, 3/16), ... [12, 16). Which one, the exponent and the
   first digit after it say; drawn by their lowest four bits, which is why 2 comes first. Least squares towards the least
   relative error, rounded one coefficient after the other. Row 0: the middles; row k + 1: the factor of power k. */
static const float dn__tanh_table[8][16] = {
   { 2.5f, 3.5f, 5.0f, 7.0f, 10.0f, 14.0f, 0.0f, 0.109375f, 0.15625f, 0.21875f, 0.3125f, 0.4375f, 0.625f, 0.875f,
     1.25f, 1.75f },
   { 0.0133857047f, 0.00182210188f, 9.07858339e-05f, 1.6628718e-06f, 3.95987509e-09f, 0.0f, 0.0f, 0.000434070069f,
     0.00125926966f, 0.0034236603f, 0.00979027059f, 0.0259299446f, 0.0704002753f, 0.296094388f, 0.151716352f,
     0.0586244613f },
   { -0.026592318f, -0.00364095578f, -0.000181861295f, -3.33124262e-06f, -9.35770661e-09f, 0.0f, 0.0f,
     0.0118681258f, 0.0240221266f, 0.0463654324f, 0.0916331783f, 0.169389904f, 0.307580829f, -0.5045169f,
     -0.28041476f, -0.113812044f },
   { 0.0262359343f, 0.00363430404f, 0.000181812604f, 3.33067715e-06f, 9.23247612e-09f, 0.0f, 0.0f, 0.107648306f,
     0.15126729f, 0.205342948f, 0.274971575f, 0.341853648f, 0.384016603f, 0.355136484f, 0.237872794f,
     0.107140034f },
   { -0.0170177389f, -0.00241172803f, -0.000118821787f, -2.17677871e-06f, -3.35929062e-09f, 0.0f, 0.333333313f,
     0.31765613f, 0.301880568f, 0.273662925f, 0.219554394f, 0.136179179f, 0.0178401619f, -0.0818061307f,
     -0.108325303f, -0.0629281327f },
   { 0.00805320963f, 0.00119728537f, 5.94776939e-05f, 1.08988138e-06f, 1.76423021e-09f, 0.0f, 9.94176207e-06f,
     -0.0727713034f, -0.096752502f, -0.127987117f, -0.158144981f, -0.169675633f, -0.138034686f, -0.0613301434f,
     0.0125323832f, 0.0235160235f },
   { -0.00288642058f, -0.000490368402f, -2.84818107e-05f, -5.22859636e-07f, -2.07959316e-09f, 0.0f, -0.133898318f,
     -0.138344392f, -0.106934696f, -0.0852892548f, -0.0459193289f, 0.00489231152f, 0.0542266816f, 0.0586026795f,
     0.0196805391f, -0.00348372338f },
   { 0.000692252768f, 0.000157763323f, 9.41816506e-06f, 1.73279275e-07f, 6.78989143e-10f, 0.0f, 0.00992003735f,
     5.10726023f, -0.208128914f, 0.41692251f, 0.0737856701f, 0.0130583337f, 0.0289829597f, 0.00650026044f,
     -0.0145724788f, -0.00200268952f }
};
DN__TARGET_AVX512 static DN__INLINE __m512 dn__tanh_avx512(__m512 x, int shrink) /* dn__tanh or dn__tanhshrink */
{
   const __m512 sign = _mm512_set1_ps(-0.0f), one = _mm512_set1_ps(1.0f);
   __m512 size = _mm512_andnot_ps(sign, x), bounded = _mm512_maskz_min_ps(DN__ALL, _mm512_set1_ps(15.99f), size), q, u;
   __mmask16 tiny = _mm512_cmp_ps_mask(size, _mm512_set1_ps(0.75f), _CMP_LT_OQ);
   __m512i which = _mm512_maskz_srli_epi32(DN__ALL,
      _mm512_castps_si512(_mm512_maskz_max_ps(DN__ALL, bounded, _mm512_set1_ps(0.0625f))), 22);
   #define DN__OF(k) _mm512_maskz_permutexvar_ps(DN__ALL, which, _mm512_loadu_ps(dn__tanh_table[k]))
   u = _mm512_sub_ps(bounded, DN__OF(0));
   q = _mm512_fmadd_ps(DN__OF(7), u, DN__OF(6));
   q = _mm512_fmadd_ps(q, u, DN__OF(5));
   q = _mm512_fmadd_ps(q, u, DN__OF(4));
   q = _mm512_fmadd_ps(q, u, DN__OF(3));
   q = _mm512_fmadd_ps(q, u, DN__OF(2));
   q = _mm512_fmadd_ps(q, u, DN__OF(1));
   #undef DN__OF
   if (shrink) q = _mm512_mask_add_ps(q, _mm512_knot(tiny), _mm512_sub_ps(size, one), q);
   else q = _mm512_sub_ps(_mm512_mask_blend_ps(tiny, one, size), q);
   return _mm512_or_ps(q, _mm512_and_ps(sign, x));
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
DN__TARGET_AVX512 static DN__INLINE __mmask16 dn__lanes_avx512(size_t count) /* the first `count` of 16 */
{
   return (__mmask16)(count < 16 ? (1u << count) - 1u : 0xffffu);
}
DN__TARGET_AVX512 static void dn__activate_avx512(const float *from, size_t from_stride, float *to, size_t to_stride,
                                                  size_t rows, size_t columns, dn_activation activation)
{
   size_t c;
   for (; rows > 0; rows--, from += from_stride, to += to_stride) {
      for (c = 0; c + 16 <= columns; c += 16)
         _mm512_storeu_ps(to + c, dn__act_avx512(_mm512_loadu_ps(from + c), activation));
      if (c < columns)
         _mm512_mask_storeu_ps(to + c, dn__lanes_avx512(columns - c), dn__act_avx512(_mm512_loadu_ps(from + c), activation));
   }
}
DN__TARGET_AVX512 static DN__INLINE __m512 dn__start_avx512(const float *columns, size_t at)
{
   return columns ? _mm512_loadu_ps(columns + at) : _mm512_setzero_ps();
}
DN__TARGET_AVX512 static DN__INLINE __m512 dn__scale_avx512(const float *columns, __m512 *rest, __m512 *shift)
{
   *rest = columns ? _mm512_loadu_ps(columns + 3 * DN_PANEL) : _mm512_setzero_ps();
   *shift = columns ? _mm512_loadu_ps(columns + 4 * DN_PANEL) : _mm512_setzero_ps();
   return columns ? _mm512_loadu_ps(columns + 2 * DN_PANEL) : _mm512_set1_ps(1.0f);
}
DN__TARGET_AVX512 static DN__INLINE __m512 dn__bn_avx512(__m512 sum, __m512 scale, __m512 rest, __m512 shift)
{
   return _mm512_fmadd_ps(sum, scale, _mm512_fmadd_ps(sum, rest, shift));
}
/* gcc 12 and clang 14 carry loads past the registers there are and copy sums about. Told the instruction they do
   neither, and keep the order of the text, which is what lays the additions between the products. */
#if defined(__GNUC__) || defined(__clang__)
typedef struct dn__sixteen { float f[16]; } dn__sixteen;
   #define DN__FMA(sum, v, w) __asm__ __volatile__("vfmadd231ps %2, %1, %0" : "+v"(sum) : "v"(v), "v"(w))
   #define DN__ADD(to, a, b) __asm__ __volatile__("vaddps %2, %1, %0" : "=v"(to) : "v"(a), "v"(b))
   #define DN__SUB(to, a, b) __asm__ __volatile__("vsubps %2, %1, %0" : "=v"(to) : "v"(a), "v"(b))
   #define DN__LOAD(to, p) __asm__ __volatile__("vmovups %1, %0" : "=v"(to) : "m"(*(const dn__sixteen *)(const void *)(p)))
   #define DN__ALL_OF(to, p) __asm__ __volatile__("vbroadcastss %1, %0" : "=v"(to) : "m"(*(p)))
#else
   #define DN__FMA(sum, v, w) sum = _mm512_fmadd_ps(v, w, sum)
   #define DN__ADD(to, a, b) to = _mm512_add_ps(a, b)
   #define DN__SUB(to, a, b) to = _mm512_sub_ps(a, b)
   #define DN__LOAD(to, p) to = _mm512_loadu_ps(p)
   #define DN__ALL_OF(to, p) to = _mm512_set1_ps(*(p))
#endif
#define DN__CARRY(run, total) /* as at DN__RUN */                                                            \
   DN__ADD(v, total, run);                                                                                   \
   DN__SUB(total, total, v);                                                                                 \
   DN__ADD(run, total, run);                                                                                 \
   total = v;
#define DN__FOUR /* terms, or what is left of them */                                                        \
   if (in - c >= 4) {                                                                                        \
      DN__TERM(0) DN__TERM(1) DN__TERM(2) DN__TERM(3)                                                        \
      DN__STEP(4)                                                                                            \
   } else {                                                                                                  \
      while (c < in) {                                                                                       \
         DN__TERM(0)                                                                                         \
         DN__STEP(1)                                                                                         \
      }                                                                                                      \
   }
/* 7 rows x 2 panels: 14 runs, 14 totals, 2 weights, 1 broadcast x, 1 to add with: all 32 registers. Totals in memory
   would double the rows, but 28 stores in a row hold up the products. The left panel's runs end where the right one's
   are half done: fewer additions in a row. */
DN__TARGET_AVX512 static void dn__tile2_avx512(const float *x, size_t x_stride, size_t in, const float *w,
                                               const float *columns, float *total, const dn__target *y)
{
   const float *x0 = x, *x1 = x0 + x_stride, *x2 = x1 + x_stride, *x3 = x2 + x_stride, *x4 = x3 + x_stride,
               *x5 = x4 + x_stride, *x6 = x5 + x_stride, *u = w + in * DN_PANEL;
   __m512 w0 = dn__start_avx512(columns, 0), w1 = dn__start_avx512(columns, DN__COLUMN), v;
   size_t c = 0;
   (void)total; /* kept in registers */
#define DN__START(r)                                                                                         \
   __m512 a##r = dn__start_avx512(columns, DN_PANEL), s##r = w0,                                             \
          b##r = dn__start_avx512(columns, DN__COLUMN + DN_PANEL), t##r = w1;
#define DN__TERM(k)                                                                                          \
   {                                                                                                         \
      enum { K = k };                                                                                        \
      DN__LOAD(w0, w + K * DN_PANEL);                                                                        \
      DN__LOAD(w1, u + K * DN_PANEL);                                                                        \
      DN__EACH7(DN__PRODUCT)                                                                                 \
   }
#define DN__PRODUCT(r)                                                                                       \
   DN__ALL_OF(v, x##r + c + K);                                                                              \
   DN__FMA(a##r, v, w0);                                                                                     \
   DN__FMA(b##r, v, w1);
#define DN__LEFT(r) DN__CARRY(a##r, s##r)
#define DN__RIGHT(r) DN__CARRY(b##r, t##r)
#define DN__STEP(n) c += n, w += n * DN_PANEL, u += n * DN_PANEL;
#define DN__STORE(r)                                                                                         \
   _mm512_storeu_ps(y->at + r * y->stride, dn__bn_avx512(_mm512_add_ps(s##r, a##r), w0, w1, v));
#define DN__STORE2(r)                                                                                        \
   _mm512_storeu_ps(y[1].at + r * y[1].stride, dn__bn_avx512(_mm512_add_ps(t##r, b##r), w0, w1, v));
   {
      DN__EACH7(DN__START)
      while (c < in) {
         DN__EACH7(DN__LEFT)
         DN__FOUR
         DN__EACH7(DN__RIGHT)
         DN__FOUR
      }
      w0 = dn__scale_avx512(columns, &w1, &v);
      DN__EACH7(DN__STORE)
      w0 = dn__scale_avx512(columns ? columns + DN__COLUMN : NULL, &w1, &v);
      DN__EACH7(DN__STORE2)
   }
#undef DN__START
#undef DN__TERM
#undef DN__PRODUCT
#undef DN__STEP
#undef DN__STORE
}
/* 14 rows x 1 panel, for the last of an odd number. One load for each product is what bounds it. Adds up as the left
   panel above. */
DN__TARGET_AVX512 static void dn__tile1_avx512(const float *x, size_t x_stride, size_t in, const float *w,
                                               const float *columns, float *total, const dn__target *y)
{
   const float *x0 = x, *x4 = x + 4 * x_stride, *x8 = x + 8 * x_stride, *x12 = x + 12 * x_stride;
   __m512 w0 = dn__start_avx512(columns, 0), v, rest;
   size_t c = 0;
   (void)total;
#define DN__START(r) __m512 a##r = dn__start_avx512(columns, DN_PANEL), s##r = w0;
#define DN__TERM(k)                                                                                          \
   {                                                                                                         \
      enum { K = k };                                                                                        \
      DN__LOAD(w0, w + K * DN_PANEL);                                                                        \
      DN__EACH14(DN__PRODUCT)                                                                                \
   }
#define DN__PRODUCT(r)                                                                                       \
   DN__ALL_OF(v, (r < 4 ? x0 : r < 8 ? x4 : r < 12 ? x8 : x12) + r % 4 * x_stride + K);                      \
   DN__FMA(a##r, v, w0);
#define DN__STEP(n) c += n, w += n * DN_PANEL, x0 += n, x4 += n, x8 += n, x12 += n;
#define DN__STORE(r)                                                                                         \
   _mm512_storeu_ps(y->at + r * y->stride, dn__bn_avx512(_mm512_add_ps(s##r, a##r), w0, rest, v));
   {
      DN__EACH14(DN__START)
      while (c < in) {
         DN__EACH14(DN__LEFT)
         DN__FOUR
         DN__FOUR
      }
      w0 = dn__scale_avx512(columns, &rest, &v);
      DN__EACH14(DN__STORE)
   }
#undef DN__START
#undef DN__TERM
#undef DN__PRODUCT
#undef DN__STEP
#undef DN__STORE
}
#undef DN__STORE2
#undef DN__LEFT
#undef DN__RIGHT
#undef DN__FOUR
#undef DN__CARRY
#undef DN__FMA
#undef DN__ADD
#undef DN__SUB
#undef DN__LOAD
#undef DN__ALL_OF
#endif /* DN__HAS_AVX512 */

#if defined(DN__F4_NEON) || defined(DN__F4_WASM) || defined(DN__F4_SSE)
#define DN__HAS_F4
/* --- four lanes: NEON, WebAssembly SIMD and SSE2 share one text over these few operations.
   max, min and floor of NaN are NaN when it is the second operand; pick(a, b, p, q) is a < b ? p : q. */
   #if defined(DN__F4_NEON)
      #define DN__F4_KERNEL DN_KERNEL_NEON
      #define DN__F4_ROWS 6 /* 24 sums of 32 registers */
      #define DN__F4_RUN DN__RUN
      #define DN__F4_EACH DN__EACH6
typedef float32x4_t dn__f4;
static DN__INLINE dn__f4 dn__f4_load(const float *p) { return vld1q_f32(p); }
static DN__INLINE void dn__f4_store(float *p, dn__f4 a) { vst1q_f32(p, a); }
static DN__INLINE dn__f4 dn__f4_all(float a) { return vdupq_n_f32(a); }
static DN__INLINE dn__f4 dn__f4_add(dn__f4 a, dn__f4 b) { return vaddq_f32(a, b); }
static DN__INLINE dn__f4 dn__f4_sub(dn__f4 a, dn__f4 b) { return vsubq_f32(a, b); }
static DN__INLINE dn__f4 dn__f4_mul(dn__f4 a, dn__f4 b) { return vmulq_f32(a, b); }
static DN__INLINE dn__f4 dn__f4_div(dn__f4 a, dn__f4 b) { return vdivq_f32(a, b); }
static DN__INLINE dn__f4 dn__f4_sqrt(dn__f4 a) { return vsqrtq_f32(a); }
static DN__INLINE dn__f4 dn__f4_yzx(dn__f4 a) /* a[1] a[2] a[0], anything */
{
   return vcombine_f32(vget_low_f32(vextq_f32(a, a, 1)), vget_low_f32(a));
}
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
      #define DN__F4_RUN DN__RUN_SHORT
      #define DN__F4_EACH DN__EACH3
typedef v128_t dn__f4;
static DN__INLINE dn__f4 dn__f4_load(const float *p) { return wasm_v128_load(p); }
static DN__INLINE void dn__f4_store(float *p, dn__f4 a) { wasm_v128_store(p, a); }
static DN__INLINE dn__f4 dn__f4_all(float a) { return wasm_f32x4_splat(a); }
static DN__INLINE dn__f4 dn__f4_add(dn__f4 a, dn__f4 b) { return wasm_f32x4_add(a, b); }
static DN__INLINE dn__f4 dn__f4_sub(dn__f4 a, dn__f4 b) { return wasm_f32x4_sub(a, b); }
static DN__INLINE dn__f4 dn__f4_mul(dn__f4 a, dn__f4 b) { return wasm_f32x4_mul(a, b); }
static DN__INLINE dn__f4 dn__f4_div(dn__f4 a, dn__f4 b) { return wasm_f32x4_div(a, b); }
static DN__INLINE dn__f4 dn__f4_sqrt(dn__f4 a) { return wasm_f32x4_sqrt(a); }
static DN__INLINE dn__f4 dn__f4_yzx(dn__f4 a) { return wasm_i32x4_shuffle(a, a, 1, 2, 0, 3); } /* a[1] a[2] a[0], anything */
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
      #define DN__F4_RUN DN__RUN_SHORT
      #define DN__F4_EACH DN__EACH3
typedef __m128 dn__f4;
static DN__INLINE dn__f4 dn__f4_load(const float *p) { return _mm_loadu_ps(p); }
static DN__INLINE void dn__f4_store(float *p, dn__f4 a) { _mm_storeu_ps(p, a); }
static DN__INLINE dn__f4 dn__f4_all(float a) { return _mm_set1_ps(a); }
static DN__INLINE dn__f4 dn__f4_add(dn__f4 a, dn__f4 b) { return _mm_add_ps(a, b); }
static DN__INLINE dn__f4 dn__f4_sub(dn__f4 a, dn__f4 b) { return _mm_sub_ps(a, b); }
static DN__INLINE dn__f4 dn__f4_mul(dn__f4 a, dn__f4 b) { return _mm_mul_ps(a, b); }
static DN__INLINE dn__f4 dn__f4_div(dn__f4 a, dn__f4 b) { return _mm_div_ps(a, b); }
static DN__INLINE dn__f4 dn__f4_sqrt(dn__f4 a) { return _mm_sqrt_ps(a); }
static DN__INLINE dn__f4 dn__f4_yzx(dn__f4 a) { return _mm_shuffle_ps(a, a, 0xc9); } /* a[1] a[2] a[0], anything */
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
   t = dn__f4_div(dn__f4_add(t, t), dn__f4_add(one, t)); /* 1 - tanh |x| */
   t = shrink ? dn__f4_add(dn__f4_sub(size, one), t) : dn__f4_sub(one, t);
   t = dn__f4_pick(x, zero, dn__f4_sub(zero, t), t); /* large x */
   return dn__f4_pick(size, bend, shrink ? s : dn__f4_sub(x, s), t);
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
static void dn__activate_f4(const float *from, size_t from_stride, float *to, size_t to_stride, size_t rows,
                            size_t columns, dn_activation activation)
{
   size_t c;
   for (; rows > 0; rows--, from += from_stride, to += to_stride)
      for (c = 0; c < columns; c += 4)
         dn__store_f4(to + c, columns - c, dn__act_f4(dn__f4_load(from + c), activation));
}
static DN__INLINE dn__f4 dn__carry_f4(float *total, dn__f4 run) /* as dn__carry_avx2 */
{
   dn__f4 before = dn__f4_load(total), after = dn__f4_add(before, run);
   dn__f4_store(total, after);
   return dn__f4_add(dn__f4_sub(before, after), run);
}
static DN__INLINE dn__f4 dn__start_f4(const float *columns, size_t at)
{
   return columns ? dn__f4_load(columns + at) : dn__f4_all(0.0f);
}
/* y = (total + run) scale + shift, four columns from `at` on */
static DN__INLINE void dn__bn_f4(float *y, const float *total, dn__f4 run, const float *columns, size_t at)
{
   dn__f4 sum = dn__f4_add(dn__f4_load(total + at), run);
   if (columns) {
      dn__f4 shift = dn__f4_load(columns + 4 * DN_PANEL + at);
      shift = dn__f4_fma(sum, dn__f4_load(columns + 3 * DN_PANEL + at), shift);
      sum = dn__f4_fma(sum, dn__f4_load(columns + 2 * DN_PANEL + at), shift);
   }
   dn__f4_store(y + at, sum);
}
static void dn__tile_f4(const float *x, size_t x_stride, size_t in, const float *w, const float *columns,
                        float *total, const dn__target *y)
{
   dn__f4 w0 = dn__start_f4(columns, 0), w1 = dn__start_f4(columns, 4), w2 = dn__start_f4(columns, 8),
          w3 = dn__start_f4(columns, 12), v;
   size_t n, end;
#define DN__START(r)                                                                                         \
   dn__f4 a##r = dn__start_f4(columns, 16), b##r = dn__start_f4(columns, 20),                                \
          c##r = dn__start_f4(columns, 24), d##r = dn__start_f4(columns, 28);                                \
   dn__f4_store(total + r * DN_PANEL, w0);                                                                   \
   dn__f4_store(total + r * DN_PANEL + 4, w1);                                                               \
   dn__f4_store(total + r * DN_PANEL + 8, w2);                                                               \
   dn__f4_store(total + r * DN_PANEL + 12, w3);
#define DN__STEP(r)                                                                                          \
   v = dn__f4_all(x[r * x_stride + n]);                                                                      \
   a##r = dn__f4_fma(v, w0, a##r);                                                                           \
   b##r = dn__f4_fma(v, w1, b##r);                                                                           \
   c##r = dn__f4_fma(v, w2, c##r);                                                                           \
   d##r = dn__f4_fma(v, w3, d##r);
#define DN__CARRY(r)                                                                                         \
   a##r = dn__carry_f4(total + r * DN_PANEL, a##r);                                                          \
   b##r = dn__carry_f4(total + r * DN_PANEL + 4, b##r);                                                      \
   c##r = dn__carry_f4(total + r * DN_PANEL + 8, c##r);                                                      \
   d##r = dn__carry_f4(total + r * DN_PANEL + 12, d##r);
#define DN__STORE(r)                                                                                         \
   dn__bn_f4(y->at + r * y->stride, total + r * DN_PANEL, a##r, columns, 0);                                      \
   dn__bn_f4(y->at + r * y->stride, total + r * DN_PANEL, b##r, columns, 4);                                      \
   dn__bn_f4(y->at + r * y->stride, total + r * DN_PANEL, c##r, columns, 8);                                      \
   dn__bn_f4(y->at + r * y->stride, total + r * DN_PANEL, d##r, columns, 12);
   {
      DN__F4_EACH(DN__START)
      for (n = 0; n < in;) {
         for (end = dn__min(in, n + DN__F4_RUN); n < end; n++, w += DN_PANEL) {
            w0 = dn__f4_load(w);
            w1 = dn__f4_load(w + 4);
            w2 = dn__f4_load(w + 8);
            w3 = dn__f4_load(w + 12);
            DN__F4_EACH(DN__STEP)
         }
         DN__IN_MEMORY();
         DN__F4_EACH(DN__CARRY)
      }
      DN__F4_EACH(DN__STORE)
   }
#undef DN__START
#undef DN__STEP
#undef DN__CARRY
#undef DN__STORE
}
#endif /* four lanes */

/* --- the choice. The attention texts live in >>attention; the table that joins them is at the end of that part. */
static const dn__kernel *dn__kernel_of(dn_kernel kernel); /* NULL: the reference */

#ifdef DN__HAS_AVX2
static void dn__cpuid(unsigned leaf, unsigned part, unsigned out[4])
{
   #if defined(_MSC_VER) && !defined(__clang__)
   int r[4];
   __cpuidex(r, (int)leaf, (int)part);
   memcpy(out, r, 16);
   #elif defined(__x86_64__)
   /* not cpuid.h's macro: clang 14's may put %1 into the register of the leaf (no early clobber) */
   __asm__ __volatile__("xchgq %%rbx, %q1\n\tcpuid\n\txchgq %%rbx, %q1"
                        : "=a"(out[0]), "=&r"(out[1]), "=c"(out[2]), "=d"(out[3]) : "0"(leaf), "2"(part));
   #else
   __cpuid_count(leaf, part, out[0], out[1], out[2], out[3]);
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
   const unsigned osxsave = 1u << 27, fma = 1u << 12, avx = 1u << 28, f16c = 1u << 29, avx2 = 1u << 5;
   const unsigned avx512 = 1u << 16 | 1u << 17 | 1u << 30 | 1u << 31; /* F, DQ, BW, VL */
   unsigned r[4], saved;
   dn__cpuid(0, 0, r);
   if (r[0] < 7) return 0;
   dn__cpuid(1, 0, r);
   if ((r[2] & (osxsave | fma | avx | f16c)) != (osxsave | fma | avx | f16c)) return 0;
   saved = dn__xgetbv();
   dn__cpuid(7, 0, r);
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
   while (--k > DN_KERNEL_REF && !dn_kernel_available((dn_kernel)k)) {}
   return (dn_kernel)k;
}
DN_API const char *dn_kernel_name(dn_kernel kernel)
{
   static const char *const names[] = { "automatic", "reference", "sse", "avx2", "avx512", "neon", "wasm" };
   if (kernel == DN_KERNEL_AUTO) kernel = dn__kernel_best();
   return (unsigned)kernel < (unsigned)DN_KERNEL_COUNT ? names[kernel] : "unknown";
}
DN_API const char *dn_precision_name(dn_precision precision)
{
   static const char *const names[] = { "f32", "f16", "bf16", "int8" };
   return (unsigned)precision < (unsigned)DN_PRECISION_COUNT ? names[precision] : "unknown";
}

/* y = act(bn(x W^T + b) + add), rows begin to end - 1, in tiles; but the first `plain` columns, whole panels, go to z,
   without the activation. A last tile that would stick out is moved back over rows already done, whose bits it repeats; where
   there are fewer rows than a tile has, they go one by one, each as all rows of a tile. A last panel that sticks out
   past `out` goes through a buffer.
   Panels outside, rows inside, some rows at a time: these stay in the second-level cache while the weights pass through
   the first. The places that the next panels will fill are asked for meanwhile: where y has left the caches, 504 -> 512
   columns go from 200 to 235 GFLOP/s of 256. */
#define DN__BLOCK_ROWS ((size_t)84)
typedef struct dn__product_job {
   const dn_linear *l;
   const dn__kernel *k;
   const float *x;
   float *z, *y;
   size_t x_stride, z_stride, y_stride, plain;
} dn__product_job;
static dn__target dn__product_target(const dn__product_job *j, size_t r, size_t column)
{
   dn__target p;
   int plain = column < j->plain;
   p.stride = plain ? j->z_stride : j->y_stride;
   p.at = plain ? j->z + r * p.stride + column : j->y + r * p.stride + (column - j->plain);
   return p;
}
/* inline: gcc 12 finds that a function of prefetches does nothing, and leaves its calls out */
static DN__INLINE void dn__product_ahead(const dn__product_job *j, size_t r, size_t column, size_t rows)
{
   size_t i, q;
   for (q = 0; q < 2 && column < j->l->out; q++, column += DN_PANEL) {
      dn__target to = dn__product_target(j, r, column);
      for (i = 0; i < rows; i++) DN__SOON(to.at + i * to.stride);
   }
}
/* panels p to p + panels - 1, one or two, of rows begin to end - 1 of first to last - 1 */
static void dn__product_panels(const dn__product_job *j, size_t p, size_t panels, size_t begin, size_t end, size_t first,
                               size_t last)
{
   const dn_linear *l = j->l;
   const dn__tile *tile = panels == 2 ? &j->k->two : &j->k->one;
   const float *w = l->panels + p * l->in * DN_PANEL, *n = l->columns ? l->columns + p * DN__COLUMN : NULL;
   float buffer[2][DN__TILE_ROWS * DN_PANEL], total[DN__TILE_ROWS * DN_PANEL];
   size_t r, rows, q, next = (p + panels) * DN_PANEL;
   for (r = begin; r < end; r += rows) {
      dn__target to[2], place[2];
      rows = tile->rows;
      if (end - first < rows) rows = 1;
      else if (end - r < rows) r = end - rows;
      for (q = 0; q < panels; q++) {
         place[q] = to[q] = dn__product_target(j, r, (p + q) * DN_PANEL);
         if (rows == 1 || (p + q + 1) * DN_PANEL > l->out) place[q].at = buffer[q], place[q].stride = DN_PANEL;
      }
      if (rows > 1 && next < l->out) dn__product_ahead(j, r, next, rows);
      else if (last - r >= DN__BLOCK_ROWS + rows) dn__product_ahead(j, r + DN__BLOCK_ROWS, 0, rows);
      tile->run(j->x + r * j->x_stride, rows == 1 ? 0 : j->x_stride, l->in, w, n, total, place);
      for (q = 0; q < panels; q++) {
         size_t at = (p + q) * DN_PANEL, fit = dn__min(DN_PANEL, l->out - at), i, c;
         dn_activation activation = at < j->plain || l->activation == DN_ACT_SOFTMAX ? DN_ACT_NONE : l->activation;
         for (i = 0; l->add && i < rows; i++)
            for (c = 0; c < fit; c++) place[q].at[i * place[q].stride + c] += l->add[(r + i) * l->out + at + c];
         if (place[q].at != to[q].at || activation != DN_ACT_NONE)
            j->k->activate(place[q].at, place[q].stride, to[q].at, to[q].stride, rows, fit, activation);
      }
   }
}
static void dn__product_split(const dn_linear *l, const float *x, size_t x_stride, float *z, size_t z_stride,
                              size_t plain, float *y, size_t y_stride, size_t begin, size_t end)
{
   size_t all = (l->out + DN_PANEL - 1) / DN_PANEL, r, p, panels, i;
   dn__product_job j;
   j.l = l, j.k = dn__kernel_of(l->kernel);
   j.x = x, j.z = z, j.y = y;
   j.x_stride = x_stride, j.z_stride = z_stride, j.y_stride = y_stride;
   j.plain = plain;
   for (r = begin; r < end; r += DN__BLOCK_ROWS) {
      size_t to = dn__min(end, r + DN__BLOCK_ROWS);
      for (p = 0; p < all; p += panels) {
         panels = j.k->two.rows && all - p >= 2 ? 2 : 1;
         dn__product_panels(&j, p, panels, r, to, begin, end);
      }
   }
   for (i = begin; l->activation == DN_ACT_SOFTMAX && i < end; i++) dn__softmax(y + i * y_stride, l->out);
}
static void dn__product(const dn_linear *l, const float *x, size_t x_stride, float *y, size_t y_stride, size_t begin,
                        size_t end)
{
   if (dn__kernel_of(l->kernel)) dn__product_split(l, x, x_stride, NULL, 0, 0, y, y_stride, begin, end);
   else dn__product_ref(l, x, x_stride, y, y_stride, begin, end);
}

/* --- linear layers. Packing finds each column's five numbers in double. A variance that is none gives NaN, never a
   trap. */
static void dn__two_floats(double x, float *most, float *rest) /* rest is 0 where x does not fit or is none */
{
   *most = dn__narrow(x);
   *rest = dn__finite(*most) ? dn__narrow(x - (double)*most) : 0.0f;
}
static float *dn__panel_at(float *panels, size_t in, size_t column) /* its weights lie 16 apart from here */
{
   return panels + column / DN_PANEL * in * DN_PANEL + column % DN_PANEL;
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
/* the five numbers of a column whose channel of the batch norm (NULL: none) is `channel` */
static void dn__column_pack(float *columns, size_t column, double bias, const dn_batchnorm *bn, size_t channel)
{
   float *n = dn__panel_at(columns, 5, column);
   double scale, shift;
   dn__fold(bn, channel, &scale, &shift);
   dn__two_floats(bn ? bias - (double)bn->mean[channel] : bias, &n[0], &n[DN_PANEL]);
   dn__two_floats(scale, &n[2 * DN_PANEL], &n[3 * DN_PANEL]);
   n[4 * DN_PANEL] = bn ? bn->bias[channel] : 0.0f;
}
static void dn__linear_carve(dn__arena *a, size_t in, size_t out, float **panels, float **columns)
{
   size_t width = dn__round(out, DN_PANEL);
   *panels = (float *)dn__take(a, dn__mul(width, in), sizeof(float));
   *columns = (float *)dn__take(a, dn__mul(width, 5), sizeof(float));
}
DN_API size_t dn_linear_size(size_t in, size_t out)
{
   dn__arena a = dn__arena_of(NULL, 0);
   float *panels, *columns;
   dn__linear_carve(&a, in, out, &panels, &columns);
   return in == 0 || out == 0 || dn__gauge(&a) == SIZE_MAX ? 0 : dn__gauge(&a);
}
DN_API void dn_linear_pack(dn_linear *layer, size_t in, size_t out, const float *weight, const float *bias,
                           const dn_batchnorm *bn, dn_activation activation, void *memory)
{
   dn__arena a = dn__arena_of(memory, SIZE_MAX);
   float *panels, *columns;
   size_t o, c;
   DN_ASSERT(dn_linear_size(in, out) != 0 && ((size_t)(uintptr_t)memory & (DN__ALIGN - 1)) == 0);
   dn__linear_carve(&a, in, out, &panels, &columns);
   memset(memory, 0, dn__gauge(&a)); /* columns past `out` stay zero */
   for (o = 0; o < out; o++) {
      float *w = dn__panel_at(panels, in, o);
      for (c = 0; c < in; c++) w[c * DN_PANEL] = weight[o * in + c];
      dn__column_pack(columns, o, bias ? (double)bias[o] : 0.0, bn, o);
   }
   layer->in = in;
   layer->out = out;
   layer->activation = activation;
   layer->panels = panels;
   layer->columns = columns;
   layer->add = NULL;
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

/* ===================================================================================== >>lbs
   in       rest points, joints and weights (V,I), palette (S,12)     out   skinned points (V,3), which may be the rest points
   touches  the output range it is given, nothing else
   paper    T 2.1. dn__lbs_range in >>skin is the specification and sums in double, which the network's rows need; vertices
            to be drawn do not, and these sum in float: three units in the last place of the largest product at most
   order    p = (w_0 P_0 + w_1 P_1 + ..) [x y z 1], each row (m0 x + m2 z) + (m1 y + m3). Every point stands for itself: it
            has the same bits wherever a range begins or ends
   read     dn__lbs_run, dn__lbs_f4 */

#ifdef DN__HAS_AVX512
/* Rows 0, 1, 2 of a joint fill three quarters of a register. Result: point k's blended rows times x y z 1, the coordinates
   taken from p = x0 y0 z0 x1 .. */
DN__TARGET_AVX512 static DN__INLINE __m512 dn__lbs_terms_avx512(__m512 p, int k, const uint32_t *joint, const float *weight,
                                                                size_t influences, const float *palette, size_t entry)
{
   const __m512i spread = _mm512_maskz_add_epi32(DN__ALL, _mm512_set1_epi32(3 * k),
                                                   _mm512_setr_epi32(0, 1, 2, 0, 0, 1, 2, 0, 0, 1, 2, 0, 0, 1, 2, 0));
   __m512 m;
   size_t i;
#define DN__ENTRY(i) (palette + entry * (size_t)joint[i])
#define DN__ROWS(i) (entry == 16 ? _mm512_loadu_ps(DN__ENTRY(i)) : _mm512_maskz_loadu_ps(0x0fff, DN__ENTRY(i)))
   if (influences == 4) { /* two weights through the load ports, two through the shuffles: both are busy */
      const __m128 w = _mm_loadu_ps(weight);
      m = _mm512_mul_ps(_mm512_maskz_broadcastss_ps(DN__ALL, w), DN__ROWS(0));
      m = _mm512_fmadd_ps(_mm512_maskz_permutexvar_ps(DN__ALL, _mm512_set1_epi32(1), _mm512_castps128_ps512(w)), DN__ROWS(1), m);
      m = _mm512_fmadd_ps(_mm512_set1_ps(weight[2]), DN__ROWS(2), m);
      m = _mm512_fmadd_ps(_mm512_set1_ps(weight[3]), DN__ROWS(3), m);
   } else {
      m = _mm512_mul_ps(_mm512_set1_ps(weight[0]), DN__ROWS(0));
      for (i = 1; i < influences; i++) m = _mm512_fmadd_ps(_mm512_set1_ps(weight[i]), DN__ROWS(i), m);
   }
#undef DN__ENTRY
#undef DN__ROWS
   return _mm512_mul_ps(m, _mm512_mask_permutexvar_ps(_mm512_set1_ps(1.0f), 0x7777, spread, p));
}
/* four points at a time: adding up each quarter's four numbers transposes them. Points from `count` on repeat the last. */
DN__TARGET_AVX512 static DN__INLINE void dn__lbs_four_avx512(const float *rest, const uint32_t *joint, const float *weight,
                                                             size_t influences, const float *palette, size_t entry, size_t count,
                                                             float *out)
{
   const __m512i pack = _mm512_setr_epi32(0, 4, 8, 1, 5, 9, 2, 6, 10, 3, 7, 11, 0, 0, 0, 0);
   const __mmask16 used = (__mmask16)((1u << 3 * count) - 1);
   const __m512 p = _mm512_maskz_loadu_ps(used, rest);
   const size_t r1 = influences * dn__min(1, count - 1), r2 = influences * dn__min(2, count - 1), r3 = influences * (count - 1);
   __m512 y0 = dn__lbs_terms_avx512(p, 0, joint, weight, influences, palette, entry);
   __m512 y1 = dn__lbs_terms_avx512(p, 1, joint + r1, weight + r1, influences, palette, entry);
   __m512 y2 = dn__lbs_terms_avx512(p, 2, joint + r2, weight + r2, influences, palette, entry);
   __m512 y3 = dn__lbs_terms_avx512(p, 3, joint + r3, weight + r3, influences, palette, entry);
   __m512 a = _mm512_add_ps(_mm512_maskz_unpacklo_ps(DN__ALL, y0, y1), _mm512_maskz_unpackhi_ps(DN__ALL, y0, y1)); /* 02 02 13 13 */
   __m512 b = _mm512_add_ps(_mm512_maskz_unpacklo_ps(DN__ALL, y2, y3), _mm512_maskz_unpackhi_ps(DN__ALL, y2, y3));
   a = _mm512_add_ps(_mm512_maskz_shuffle_ps(DN__ALL, a, b, 0x44), _mm512_maskz_shuffle_ps(DN__ALL, a, b, 0xee));
   _mm512_mask_storeu_ps(out, used, _mm512_maskz_permutexvar_ps(DN__ALL, pack, a));
}
DN__TARGET_AVX512 static void dn__lbs_avx512(const float *rest, const uint32_t *joint, const float *weight, size_t influences,
                                             const float *palette, size_t entry, size_t begin, size_t end, float *out)
{
   size_t v = begin;
   if (influences == 4 && entry == 16) /* what nearly every character has, in a frame */
      for (; v + 4 <= end; v += 4)
         dn__lbs_four_avx512(rest + 3 * v, joint + 4 * v, weight + 4 * v, 4, palette, 16, 4, out + 3 * v);
   else if (influences == 4)
      for (; v + 4 <= end; v += 4)
         dn__lbs_four_avx512(rest + 3 * v, joint + 4 * v, weight + 4 * v, 4, palette, 12, 4, out + 3 * v);
   for (; v < end; v += 4)
      dn__lbs_four_avx512(rest + 3 * v, joint + influences * v, weight + influences * v, influences, palette, entry,
                          dn__min(4, end - v), out + 3 * v);
}
#endif

#ifdef DN__HAS_AVX2
/* rows 0 and 1 in one register, row 2 in half of one */
DN__TARGET_AVX2 static DN__INLINE __m128 dn__lbs_point_avx2(__m128 p, const uint32_t *joint, const float *weight,
                                                            size_t influences, const float *palette, size_t entry)
{
   const float *m = palette + entry * (size_t)joint[0];
   __m256 w = _mm256_broadcast_ss(weight), a = _mm256_mul_ps(w, _mm256_loadu_ps(m));
   __m128 c = _mm_mul_ps(_mm256_castps256_ps128(w), _mm_loadu_ps(m + 8)), b, t;
   size_t i;
#define DN__TERM(i)                                                                                          \
   m = palette + entry * (size_t)joint[i];                                                                      \
   w = _mm256_broadcast_ss(weight + i);                                                                      \
   a = _mm256_fmadd_ps(w, _mm256_loadu_ps(m), a);                                                            \
   c = _mm_fmadd_ps(_mm256_castps256_ps128(w), _mm_loadu_ps(m + 8), c);
   if (influences == 4) {
      DN__TERM(1) DN__TERM(2) DN__TERM(3)
   } else
      for (i = 1; i < influences; i++) {
         DN__TERM(i)
      }
#undef DN__TERM
   p = _mm_blend_ps(p, _mm_set1_ps(1.0f), 8);
   c = _mm_mul_ps(c, p);
   b = _mm_mul_ps(_mm256_extractf128_ps(a, 1), p);
   p = _mm_mul_ps(_mm256_castps256_ps128(a), p);
   t = _mm_add_ps(_mm_unpacklo_ps(p, b), _mm_unpackhi_ps(p, b)); /* x02 y02 x13 y13 */
   c = _mm_add_ps(c, _mm_movehl_ps(c, c));                       /* z02 z13 */
   return _mm_add_ps(_mm_movelh_ps(t, c), _mm_shuffle_ps(t, c, 0x5e));
}
DN__TARGET_AVX2 static void dn__lbs_avx2(const float *rest, const uint32_t *joint, const float *weight, size_t influences,
                                         const float *palette, size_t entry, size_t begin, size_t end, float *out)
{
   float last[4] = { 0.0f, 0.0f, 0.0f, 0.0f };
   __m128 p, next;
   size_t v;
   memcpy(last, rest + 3 * (end - 1), 3 * sizeof *last);
   next = _mm_loadu_ps(begin + 1 < end ? rest + 3 * begin : last);
   for (v = begin; v + 1 < end; v++) { /* the fourth float of a load or store belongs to the point after it */
      p = next;
      next = _mm_loadu_ps(v + 2 < end ? rest + 3 * (v + 1) : last);
      if (influences == 4) p = dn__lbs_point_avx2(p, joint + 4 * v, weight + 4 * v, 4, palette, entry);
      else p = dn__lbs_point_avx2(p, joint + influences * v, weight + influences * v, influences, palette, entry);
      _mm_storeu_ps(out + 3 * v, p);
   }
   _mm_storeu_ps(last, dn__lbs_point_avx2(next, joint + influences * v, weight + influences * v, influences, palette, entry));
   memcpy(out + 3 * v, last, 3 * sizeof *last);
}
#endif

#ifdef DN__HAS_F4
   #if defined(DN__F4_NEON)
static DN__INLINE dn__f4 dn__f4_sums(dn__f4 a, dn__f4 b, dn__f4 c) /* of a, of b, of c, anything: each (0 + 2) + (1 + 3) */
{
   dn__f4 ab = vaddq_f32(vzip1q_f32(a, b), vzip2q_f32(a, b)); /* a02 b02 a13 b13 */
   dn__f4 cc = vaddq_f32(vzip1q_f32(c, c), vzip2q_f32(c, c));
   return vaddq_f32(vcombine_f32(vget_low_f32(ab), vget_low_f32(cc)), vcombine_f32(vget_high_f32(ab), vget_high_f32(cc)));
}
static DN__INLINE dn__f4 dn__f4_point(dn__f4 p) { return vsetq_lane_f32(1.0f, p, 3); } /* x y z 1 */
   #elif defined(DN__F4_WASM)
static DN__INLINE dn__f4 dn__f4_sums(dn__f4 a, dn__f4 b, dn__f4 c)
{
   dn__f4 ab = wasm_f32x4_add(wasm_i32x4_shuffle(a, b, 0, 4, 1, 5), wasm_i32x4_shuffle(a, b, 2, 6, 3, 7));
   dn__f4 cc = wasm_f32x4_add(c, wasm_i32x4_shuffle(c, c, 2, 3, 2, 3));
   return wasm_f32x4_add(wasm_i32x4_shuffle(ab, cc, 0, 1, 4, 4), wasm_i32x4_shuffle(ab, cc, 2, 3, 5, 5));
}
static DN__INLINE dn__f4 dn__f4_point(dn__f4 p) { return wasm_f32x4_replace_lane(p, 3, 1.0f); }
   #else
static DN__INLINE dn__f4 dn__f4_sums(dn__f4 a, dn__f4 b, dn__f4 c)
{
   dn__f4 ab = _mm_add_ps(_mm_unpacklo_ps(a, b), _mm_unpackhi_ps(a, b)), cc = _mm_add_ps(c, _mm_movehl_ps(c, c));
   return _mm_add_ps(_mm_movelh_ps(ab, cc), _mm_shuffle_ps(ab, cc, 0x5e));
}
static DN__INLINE dn__f4 dn__f4_point(dn__f4 p)
{
   const __m128 xyz = _mm_castsi128_ps(_mm_setr_epi32(-1, -1, -1, 0));
   return _mm_or_ps(_mm_and_ps(xyz, p), _mm_andnot_ps(xyz, _mm_set1_ps(1.0f)));
}
   #endif
static DN__INLINE dn__f4 dn__lbs_point_f4(dn__f4 p, const uint32_t *joint, const float *weight, size_t influences,
                                          const float *palette, size_t entry)
{
   const float *m = palette + entry * (size_t)joint[0];
   dn__f4 w = dn__f4_all(weight[0]), a = dn__f4_mul(w, dn__f4_load(m));
   dn__f4 b = dn__f4_mul(w, dn__f4_load(m + 4)), c = dn__f4_mul(w, dn__f4_load(m + 8));
   size_t i;
#define DN__TERM(i)                                                                                          \
   m = palette + entry * (size_t)joint[i];                                                                      \
   w = dn__f4_all(weight[i]);                                                                                \
   a = dn__f4_fma(w, dn__f4_load(m), a);                                                                     \
   b = dn__f4_fma(w, dn__f4_load(m + 4), b);                                                                 \
   c = dn__f4_fma(w, dn__f4_load(m + 8), c);
   if (influences == 4) {
      DN__TERM(1) DN__TERM(2) DN__TERM(3)
   } else
      for (i = 1; i < influences; i++) {
         DN__TERM(i)
      }
#undef DN__TERM
   p = dn__f4_point(p);
   return dn__f4_sums(dn__f4_mul(a, p), dn__f4_mul(b, p), dn__f4_mul(c, p));
}
static void dn__lbs_f4(const float *rest, const uint32_t *joint, const float *weight, size_t influences, const float *palette,
                       size_t entry, size_t begin, size_t end, float *out)
{
   float last[4] = { 0.0f, 0.0f, 0.0f, 0.0f };
   dn__f4 p, next;
   size_t v;
   memcpy(last, rest + 3 * (end - 1), 3 * sizeof *last);
   next = dn__f4_load(begin + 1 < end ? rest + 3 * begin : last);
   for (v = begin; v + 1 < end; v++) { /* the fourth float of a load or store belongs to the point after it */
      p = next;
      next = dn__f4_load(v + 2 < end ? rest + 3 * (v + 1) : last);
      if (influences == 4) p = dn__lbs_point_f4(p, joint + 4 * v, weight + 4 * v, 4, palette, entry);
      else p = dn__lbs_point_f4(p, joint + influences * v, weight + influences * v, influences, palette, entry);
      dn__f4_store(out + 3 * v, p);
   }
   dn__f4_store(last, dn__lbs_point_f4(next, joint + influences * v, weight + influences * v, influences, palette, entry));
   memcpy(out + 3 * v, last, 3 * sizeof *last);
}
#endif

/* points begin..end by the kernel's text; by dn__lbs_range when it has none, or nothing to blend. wide (S,16) is palette with
   each joint on a cache line of its own, or NULL */
static void dn__lbs_run(dn_kernel kernel, const float *rest, const uint32_t *joint, const float *weight, size_t influences,
                        const float *palette, const float *wide, size_t begin, size_t end, float *out)
{
   const float *m = wide ? wide : palette;
   const size_t entry = wide ? 16 : 12;
   if (begin >= end) return;
   (void)m, (void)entry;
   switch (influences ? kernel : DN_KERNEL_REF) {
#ifdef DN__HAS_AVX512
   case DN_KERNEL_AVX512: dn__lbs_avx512(rest, joint, weight, influences, m, entry, begin, end, out); break;
#endif
#ifdef DN__HAS_AVX2
   case DN_KERNEL_AVX2: dn__lbs_avx2(rest, joint, weight, influences, m, entry, begin, end, out); break;
#endif
#ifdef DN__HAS_F4
   case DN__F4_KERNEL: dn__lbs_f4(rest, joint, weight, influences, m, entry, begin, end, out); break;
#endif
   default: dn__lbs_range(rest, joint, weight, influences, palette, begin, end, out); break;
   }
}
/* below that many points, asking the processor what it can do costs more than it gains */
#define DN__LBS_MANY ((size_t)1024)
DN_API void dn_lbs(const float *rest, const uint32_t *joint, const float *weight, size_t influences, size_t count,
                   const float *palette, float *out)
{
   dn_kernel kernel = count < DN__LBS_MANY ? DN_KERNEL_REF : dn__kernel_best();
   dn__lbs_run(kernel, rest, joint, weight, influences, palette, NULL, 0, count, out);
}

/* ===================================================================================== >>features
   in       nodes, triangles, posed joints     out   normals (N,3) and the columns of rows that are wider or dearer than a copy
   touches  the output range it is given, nothing else
   paper    T 2.1, T 3.9, C 4.4. The specification is in >>mesh (normals) and >>skin (the writers of rows); the texts here sum
            in the same order and precision. Every node stands for itself: it has the same bits wherever a range begins
   padding  positions are loaded four numbers at a time: one more must lie behind the last
   read     dn__normals_fine_range, then dn__normals_fine_avx2 */

#ifdef DN__HAS_AVX2
/* u x v = (u yzx(v) - yzx(u) v), its coordinates in the order z x y: turned once, when all are summed. Not fused: the two
   sides of a doubled sheet must cancel to nothing */
DN__TARGET_AVX2_UNFUSED static void dn__normals_fine_avx2(const double *positions, const uint32_t *triangle,
                                                          const uint32_t *corner_first, const uint32_t *corner_tri,
                                                          size_t begin, size_t end, float *normals)
{
   size_t i, e;
   for (i = begin; i < end; i++) {
      __m256d sum = _mm256_setzero_pd();
      double n[4];
      for (e = corner_first[i]; e < corner_first[i + 1]; e++) {
         const uint32_t *t = triangle + 3 * (size_t)corner_tri[e];
         __m256d p = _mm256_loadu_pd(positions + 3 * (size_t)t[0]);
         __m256d u = _mm256_sub_pd(_mm256_loadu_pd(positions + 3 * (size_t)t[1]), p);
         __m256d v = _mm256_sub_pd(_mm256_loadu_pd(positions + 3 * (size_t)t[2]), p);
         p = _mm256_mul_pd(_mm256_permute4x64_pd(u, 0xc9), v);
         sum = _mm256_add_pd(sum, _mm256_sub_pd(_mm256_mul_pd(u, _mm256_permute4x64_pd(v, 0xc9)), p));
      }
      _mm256_storeu_pd(n, _mm256_permute4x64_pd(sum, 0xc9));
      dn__fine_normal(n, normals + 3 * i);
   }
}
/* the blended matrix times [rest; 1], or its 3x3 part times rest; the fourth number is anything */
DN__TARGET_AVX2 static DN__INLINE __m256d dn__fine_point_avx2(const uint32_t *joint, const float *weight, size_t influences,
                                                              const float *palette, const float *rest, int point)
{
   const __m256d p = _mm256_setr_pd((double)rest[0], (double)rest[1], (double)rest[2], 1.0);
   __m256d a = _mm256_setzero_pd(), b = a, c = a, w;
   size_t k;
   for (k = 0; k < influences; k++) {
      const float *m = palette + 12 * (size_t)joint[k];
      w = _mm256_set1_pd((double)weight[k]);
      a = _mm256_fmadd_pd(w, _mm256_cvtps_pd(_mm_loadu_ps(m)), a);
      b = _mm256_fmadd_pd(w, _mm256_cvtps_pd(_mm_loadu_ps(m + 4)), b);
      c = _mm256_fmadd_pd(w, _mm256_cvtps_pd(_mm_loadu_ps(m + 8)), c);
   }
   if (!point) { /* not 0 times the translation, which may be infinite */
      w = _mm256_setzero_pd();
      a = _mm256_blend_pd(a, w, 8), b = _mm256_blend_pd(b, w, 8), c = _mm256_blend_pd(c, w, 8);
   }
   a = _mm256_hadd_pd(_mm256_mul_pd(a, p), _mm256_mul_pd(b, p)); /* a01 b01 a23 b23 */
   c = _mm256_mul_pd(c, p);
   c = _mm256_hadd_pd(c, c);
   b = _mm256_permute2f128_pd(a, c, 0x20);
   c = _mm256_permute2f128_pd(a, c, 0x31);
   return _mm256_add_pd(b, c);
}
DN__TARGET_AVX2 static void dn__framed_lbs_avx2(const float *rest, const uint32_t *joint, const float *weight, size_t influences,
                                                const uint32_t *vertex, const float *palette, const float root[9], size_t begin,
                                                size_t end, double *out)
{
   const __m256d x = _mm256_setr_pd((double)root[0], (double)root[1], (double)root[2], 0.0);
   const __m256d y = _mm256_setr_pd((double)root[3], (double)root[4], (double)root[5], 0.0);
   const __m256d z = _mm256_setr_pd((double)root[6], (double)root[7], (double)root[8], 0.0);
   size_t i;
   for (i = begin; i < end; i++) {
      size_t at = influences * (size_t)vertex[i];
      __m256d p = influences == 4 ? dn__fine_point_avx2(joint + at, weight + at, 4, palette, rest + 3 * i, 1)
         : dn__fine_point_avx2(joint + at, weight + at, influences, palette, rest + 3 * i, 1);
      __m256d q = _mm256_mul_pd(_mm256_permute4x64_pd(p, 0x00), x); /* R^T p */
      q = _mm256_fmadd_pd(_mm256_permute4x64_pd(p, 0x55), y, q);
      q = _mm256_fmadd_pd(_mm256_permute4x64_pd(p, 0xaa), z, q);
      _mm_storeu_pd(out + 3 * i, _mm256_castpd256_pd128(q)); /* not a fourth: it may be another worker's */
      _mm_store_sd(out + 3 * i + 2, _mm256_extractf128_pd(q, 1));
   }
}
DN__TARGET_AVX2 static void dn__rows_relative_avx2(const float *rest, const uint32_t *joint, const float *weight,
                                                   size_t influences, const uint32_t *vertex, const float *palette, size_t begin,
                                                   size_t end, float *rows, size_t stride)
{
   size_t i;
   for (i = begin; i < end; i++) {
      size_t at = influences * (vertex ? (size_t)vertex[i] : i);
      float x[4];
      _mm_storeu_ps(x, _mm256_cvtpd_ps(influences == 4 ? dn__fine_point_avx2(joint + at, weight + at, 4, palette, rest + 3 * i, 0)
                                       : dn__fine_point_avx2(joint + at, weight + at, influences, palette, rest + 3 * i, 0)));
      memcpy(rows + i * stride, x, 3 * sizeof *x);
   }
}
DN__TARGET_AVX2 static void dn__rows_distance_avx2(const double *positions, const float *posed, size_t joints, size_t begin,
                                                   size_t end, float *rows, size_t stride)
{
   size_t i, s, pitch = dn__posed_pitch(joints);
   for (i = begin; i < end; i++) {
      __m256 px = _mm256_set1_ps((float)positions[3 * i]), py = _mm256_set1_ps((float)positions[3 * i + 1]);
      __m256 pz = _mm256_set1_ps((float)positions[3 * i + 2]);
      for (s = 0; s < joints; s += 8) {
         __m256 x = _mm256_sub_ps(px, _mm256_loadu_ps(posed + s)), y = _mm256_sub_ps(py, _mm256_loadu_ps(posed + pitch + s));
         __m256 z = _mm256_sub_ps(pz, _mm256_loadu_ps(posed + 2 * pitch + s));
         float last[8];
         x = _mm256_sqrt_ps(_mm256_fmadd_ps(z, z, _mm256_fmadd_ps(y, y, _mm256_mul_ps(x, x))));
         if (s + 8 <= joints) _mm256_storeu_ps(rows + i * stride + s, x);
         else _mm256_storeu_ps(last, x), memcpy(rows + i * stride + s, last, (joints - s) * sizeof *last);
      }
   }
}
DN__TARGET_AVX2 static void dn__normalise_avx2(const float *mean, const float *scale, const float *rest, size_t width,
                                               float *rows, size_t begin, size_t end)
{
   size_t i, k;
   for (i = begin; i < end; i++) {
      float *row = rows + i * width;
      for (k = 0; k + 8 <= width; k += 8) {
         __m256 x = _mm256_sub_ps(_mm256_loadu_ps(row + k), _mm256_loadu_ps(mean + k));
         _mm256_storeu_ps(row + k, _mm256_fmadd_ps(x, _mm256_loadu_ps(scale + k), _mm256_mul_ps(x, _mm256_loadu_ps(rest + k))));
      }
      dn__normalise_range(mean + k, scale + k, rest + k, width - k, row + k, 0, 1);
   }
}
#endif

#ifdef DN__HAS_AVX512
DN__TARGET_AVX512 static void dn__rows_distance_avx512(const double *positions, const float *posed, size_t joints, size_t begin,
                                                       size_t end, float *rows, size_t stride)
{
   size_t i, s, pitch = dn__posed_pitch(joints);
   for (i = begin; i < end; i++) {
      __m512 px = _mm512_set1_ps((float)positions[3 * i]), py = _mm512_set1_ps((float)positions[3 * i + 1]);
      __m512 pz = _mm512_set1_ps((float)positions[3 * i + 2]);
      for (s = 0; s < joints; s += 16) {
         __m512 x = _mm512_sub_ps(px, _mm512_loadu_ps(posed + s)), y = _mm512_sub_ps(py, _mm512_loadu_ps(posed + pitch + s));
         __m512 z = _mm512_sub_ps(pz, _mm512_loadu_ps(posed + 2 * pitch + s));
         x = _mm512_maskz_sqrt_ps(DN__ALL, _mm512_fmadd_ps(z, z, _mm512_fmadd_ps(y, y, _mm512_mul_ps(x, x))));
         _mm512_mask_storeu_ps(rows + i * stride + s, dn__lanes_avx512(joints - s), x);
      }
   }
}
DN__TARGET_AVX512 static void dn__normalise_avx512(const float *mean, const float *scale, const float *rest, size_t width,
                                                   float *rows, size_t begin, size_t end)
{
   size_t i, k;
   for (i = begin; i < end; i++)
      for (k = 0; k < width; k += 16) {
         __mmask16 used = dn__lanes_avx512(width - k);
         float *row = rows + i * width + k;
         __m512 x = _mm512_sub_ps(_mm512_maskz_loadu_ps(used, row), _mm512_maskz_loadu_ps(used, mean + k));
         __m512 y = _mm512_mul_ps(x, _mm512_maskz_loadu_ps(used, rest + k));
         _mm512_mask_storeu_ps(row, used, _mm512_fmadd_ps(x, _mm512_maskz_loadu_ps(used, scale + k), y));
      }
}
#endif

#ifdef DN__HAS_F4
/* the bits of dn__normals_range */
static void dn__normals_f4(const float *positions, const uint32_t *triangle, const uint32_t *corner_first,
                           const uint32_t *corner_tri, size_t begin, size_t end, float *normals)
{
   size_t i, e;
   for (i = begin; i < end; i++) {
      dn__f4 sum = dn__f4_all(0.0f);
      float n[4];
      for (e = corner_first[i]; e < corner_first[i + 1]; e++) {
         const uint32_t *t = triangle + 3 * (size_t)corner_tri[e];
         dn__f4 p = dn__f4_load(positions + 3 * (size_t)t[0]);
         dn__f4 u = dn__f4_sub(dn__f4_load(positions + 3 * (size_t)t[1]), p);
         dn__f4 v = dn__f4_sub(dn__f4_load(positions + 3 * (size_t)t[2]), p);
         p = dn__f4_mul(dn__f4_yzx(u), v);
         sum = dn__f4_add(sum, dn__f4_sub(dn__f4_mul(u, dn__f4_yzx(v)), p)); /* z x y, as above */
      }
      dn__f4_store(n, dn__f4_yzx(sum));
      dn__unit_normal(n);
      memcpy(normals + 3 * i, n, 3 * sizeof *n);
   }
}
static void dn__rows_distance_f4(const double *positions, const float *posed, size_t joints, size_t begin, size_t end,
                                 float *rows, size_t stride)
{
   size_t i, s, pitch = dn__posed_pitch(joints);
   for (i = begin; i < end; i++) {
      dn__f4 px = dn__f4_all((float)positions[3 * i]), py = dn__f4_all((float)positions[3 * i + 1]);
      dn__f4 pz = dn__f4_all((float)positions[3 * i + 2]);
      for (s = 0; s < joints; s += 4) {
         dn__f4 x = dn__f4_sub(px, dn__f4_load(posed + s)), y = dn__f4_sub(py, dn__f4_load(posed + pitch + s));
         dn__f4 z = dn__f4_sub(pz, dn__f4_load(posed + 2 * pitch + s));
         float last[4];
         x = dn__f4_sqrt(dn__f4_fma(z, z, dn__f4_fma(y, y, dn__f4_mul(x, x))));
         if (s + 4 <= joints) dn__f4_store(rows + i * stride + s, x);
         else dn__f4_store(last, x), memcpy(rows + i * stride + s, last, (joints - s) * sizeof *last);
      }
   }
}
static void dn__normalise_f4(const float *mean, const float *scale, const float *rest, size_t width, float *rows, size_t begin,
                             size_t end)
{
   size_t i, k;
   for (i = begin; i < end; i++) {
      float *row = rows + i * width;
      for (k = 0; k + 4 <= width; k += 4) {
         dn__f4 x = dn__f4_sub(dn__f4_load(row + k), dn__f4_load(mean + k));
         dn__f4_store(row + k, dn__f4_fma(x, dn__f4_load(scale + k), dn__f4_mul(x, dn__f4_load(rest + k))));
      }
      dn__normalise_range(mean + k, scale + k, rest + k, width - k, row + k, 0, 1);
   }
}
#endif

/* --- the choice, as in dn__lbs_run. Where a kernel has no text of its own the plain one runs. */
static void dn__normals_run(dn_kernel kernel, const float *positions, const uint32_t *triangle, const uint32_t *corner_first,
                            const uint32_t *corner_tri, size_t begin, size_t end, float *normals)
{
#ifdef DN__HAS_F4 /* four lanes are all that a point fills: every faster kernel has them too */
   if (kernel != DN_KERNEL_REF) {
      dn__normals_f4(positions, triangle, corner_first, corner_tri, begin, end, normals);
      return;
   }
#endif
   (void)kernel;
   dn__normals_range(positions, triangle, corner_first, corner_tri, begin, end, normals);
}
#ifdef DN__HAS_AVX2
static int dn__kernel_avx(dn_kernel kernel) { return kernel == DN_KERNEL_AVX2 || kernel == DN_KERNEL_AVX512; }
#endif
static void dn__normals_fine_run(dn_kernel kernel, const double *positions, const uint32_t *triangle,
                                 const uint32_t *corner_first, const uint32_t *corner_tri, size_t begin, size_t end,
                                 float *normals)
{
#ifdef DN__HAS_AVX2
   if (dn__kernel_avx(kernel)) {
      dn__normals_fine_avx2(positions, triangle, corner_first, corner_tri, begin, end, normals);
      return;
   }
#endif
   (void)kernel;
   dn__normals_fine_range(positions, triangle, corner_first, corner_tri, begin, end, normals);
}
static void dn__framed_lbs_run(dn_kernel kernel, const float *rest, const uint32_t *joint, const float *weight,
                               size_t influences, const uint32_t *vertex, const float *palette, const float root[9],
                               size_t begin, size_t end, double *out)
{
#ifdef DN__HAS_AVX2
   if (dn__kernel_avx(kernel)) {
      dn__framed_lbs_avx2(rest, joint, weight, influences, vertex, palette, root, begin, end, out);
      return;
   }
#endif
   (void)kernel;
   dn__framed_lbs(rest, joint, weight, influences, vertex, palette, root, begin, end, out);
}
static void dn__rows_relative_run(dn_kernel kernel, const float *rest, const uint32_t *joint, const float *weight,
                                  size_t influences, const uint32_t *vertex, const float *palette, size_t begin, size_t end,
                                  float *rows, size_t stride)
{
#ifdef DN__HAS_AVX2
   if (dn__kernel_avx(kernel)) {
      dn__rows_relative_avx2(rest, joint, weight, influences, vertex, palette, begin, end, rows, stride);
      return;
   }
#endif
   (void)kernel;
   dn__rows_relative(rest, joint, weight, influences, vertex, palette, begin, end, rows, stride);
}
static void dn__rows_distance_run(dn_kernel kernel, const double *positions, const float *posed, size_t joints, size_t begin,
                                  size_t end, float *rows, size_t stride)
{
   switch (kernel) {
#ifdef DN__HAS_AVX512
   case DN_KERNEL_AVX512: dn__rows_distance_avx512(positions, posed, joints, begin, end, rows, stride); break;
#endif
#ifdef DN__HAS_AVX2
   case DN_KERNEL_AVX2: dn__rows_distance_avx2(positions, posed, joints, begin, end, rows, stride); break;
#endif
#ifdef DN__HAS_F4
   case DN__F4_KERNEL: dn__rows_distance_f4(positions, posed, joints, begin, end, rows, stride); break;
#endif
   default: dn__rows_distance(positions, posed, joints, begin, end, rows, stride); break;
   }
}
/* rows (.., width), packed */
static void dn__normalise_run(dn_kernel kernel, const float *mean, const float *scale, const float *rest, size_t width,
                              float *rows, size_t begin, size_t end)
{
   switch (kernel) {
#ifdef DN__HAS_AVX512
   case DN_KERNEL_AVX512: dn__normalise_avx512(mean, scale, rest, width, rows, begin, end); break;
#endif
#ifdef DN__HAS_AVX2
   case DN_KERNEL_AVX2: dn__normalise_avx2(mean, scale, rest, width, rows, begin, end); break;
#endif
#ifdef DN__HAS_F4
   case DN__F4_KERNEL: dn__normalise_f4(mean, scale, rest, width, rows, begin, end); break;
#endif
   default: dn__normalise_range(mean, scale, rest, width, rows, begin, end); break;
   }
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

   Batch norm is applied to the columns of z and c, before the aggregation. That is exact: sum_j a_ij (s z_j + t) =
   s sum_j a_ij z_j + t, as the a_ij of a node sum to one. The logit columns are of the plain z.
   For the same reason sum_j a_ij z_j = z_i + sum_j a_ij (z_j - z_i), and that is what is computed: neighbours are
   alike, their differences small, and so is what rounding of the a_ij can do to them. */
static size_t dn__gat_width(size_t heads, size_t features) /* of a row in scratch */
{
   return dn__round(dn__add(dn__mul(heads, features), dn__mul(2, heads)), DN_PANEL);
}
static size_t dn__gat_stride(const dn_gat *b) { return dn__gat_width(b->heads, b->features); }
static void dn__gat_carve(dn__arena *a, size_t in, size_t heads, size_t features, size_t self, float **panels,
                          float **columns, uint32_t **head)
{
   dn__linear_carve(a, in, dn__add(dn__gat_width(heads, features), self), panels, columns);
   *head = (uint32_t *)dn__take(a, dn__round(dn__mul(heads, features), DN_PANEL), sizeof(uint32_t));
}
DN_API size_t dn_gat_size(size_t in, size_t heads, size_t features, size_t self)
{
   dn__arena a = dn__arena_of(NULL, 0);
   float *panels, *columns;
   uint32_t *head;
   dn__gat_carve(&a, in, heads, features, self, &panels, &columns, &head);
   return in == 0 || heads == 0 || features == 0 || dn__gauge(&a) == SIZE_MAX ? 0 : dn__gauge(&a);
}
DN_API void dn_gat_pack(dn_gat *block, size_t in, size_t heads, size_t features, size_t self, const float *lin,
                        const float *att_dst, const float *att_src, const float *self_weight, const dn_batchnorm *bn,
                        dn_activation activation, void *memory)
{
   dn__arena a = dn__arena_of(memory, SIZE_MAX);
   float *panels, *columns, *w;
   uint32_t *head;
   size_t kf = heads * features, width = dn__gat_width(heads, features), o, k, f, c;
   DN_ASSERT(dn_gat_size(in, heads, features, self) != 0 && ((size_t)(uintptr_t)memory & (DN__ALIGN - 1)) == 0);
   DN_ASSERT(self == 0 || self_weight);
   DN_ASSERT(activation != DN_ACT_SOFTMAX);
   dn__gat_carve(&a, in, heads, features, self, &panels, &columns, &head);
   memset(memory, 0, dn__gauge(&a));
   for (o = 0; o < kf + self; o++) {
      const float *from = o < kf ? lin + o * in : self_weight + (o - kf) * in;
      size_t column = o < kf ? o : width + (o - kf);
      w = dn__panel_at(panels, in, column);
      for (c = 0; c < in; c++) w[c * DN_PANEL] = from[c];
      dn__column_pack(columns, column, 0.0, bn, o);
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
      dn__column_pack(columns, kf + k, 0.0, NULL, 0);
   }
   block->in = in;
   block->heads = heads;
   block->features = features;
   block->self = self;
   block->activation = activation;
   block->panels = panels;
   block->columns = columns;
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
   l.columns = b->columns;
   l.add = NULL;
   l.kernel = b->kernel;
   return l;
}
static dn_linear dn__gat_c(const dn_gat *b)
{
   dn_linear l = dn__gat_z(b);
   l.panels += l.in * l.out;
   l.columns += l.out / DN_PANEL * DN__COLUMN;
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
static float dn__logit_most(const dn_graph *g, const float *dst, const float *src, size_t stride, size_t mask, size_t i)
{
   size_t j, count = (size_t)(g->first[i + 1] - g->first[i]) + 1;
   float own = dst[(i & mask) * stride], most = dn__leaky(own + src[(i & mask) * stride]);
   for (j = 1; j < count; j++) {
      float e = dn__leaky(own + src[(dn__member(g, i, j) & mask) * stride]);
      most = e > most ? e : most;
   }
   return most;
}
/* y_i = act(z_i + sum_j exp(e_ij - max) (z_j - z_i) / sum_j exp(e_ij - max)) for each head, nodes begin to end - 1.
   z_n is row (n & mask) of z: a ring of a power of two of rows, or mask = SIZE_MAX: all N. y starts with node `begin`. */
static void dn__attend_ref(const dn_gat *b, const dn_graph *g, const float *z, size_t mask, float *y, size_t y_stride,
                           size_t begin, size_t end)
{
   size_t stride = dn__gat_stride(b), kf = b->heads * b->features, i, j, k, f;
   for (i = begin; i < end; i++) {
      size_t count = (size_t)(g->first[i + 1] - g->first[i]) + 1;
      for (k = 0; k < b->heads; k++) {
         const float *dst = z + kf + k, *src = dst + b->heads; /* columns, rows `stride` apart */
         const float *own = z + (i & mask) * stride + k * b->features; /* (F) */
         float *to = y + (i - begin) * y_stride + k * b->features;     /* (F) */
         float most = dn__logit_most(g, dst, src, stride, mask, i), sum = 0;
         for (f = 0; f < b->features; f++) to[f] = 0;
         for (j = 0; j < count; j++) {
            size_t n = dn__member(g, i, j) & mask;
            float a = dn__exp(dn__leaky(dst[(i & mask) * stride] + src[n * stride]) - most);
            sum += a;
            for (f = 0; f < b->features; f++) to[f] += a * (z[n * stride + k * b->features + f] - own[f]);
         }
         for (f = 0; f < b->features; f++) to[f] = dn__activate(own[f] + to[f] / sum, b->activation);
      }
   }
}

/* The fast texts do the same for all heads at once, a node at a time. Since leaky rises, the largest logit comes from
   the largest source term: max_j leaky(d + s_j) = leaky(d + max_j s_j). exp(e_ij - max) of the whole neighbourhood
   goes to a small buffer (neighbours, pitch heads); then each register's worth of columns is summed over the
   neighbours, the weight of every column drawn from the buffer by its head. A neighbourhood too large for the buffer,
   or more heads than fit, takes the reference path. */
#define DN__WEIGHTS 512 /* floats of buffer: 64 neighbours of 8 heads */

#ifdef DN__HAS_AVX2
/* e_ij - max for up to 8 heads; e (count,8), idle heads 0 */
DN__TARGET_AVX2 static DN__INLINE void dn__logits_avx2(const dn_gat *b, const dn_graph *g, const float *z,
                                                       size_t stride, size_t mask, size_t i, size_t count,
                                                       __m256i heads, float *e)
{
   size_t at = b->heads * b->features, j;
   const float *src = z + at + b->heads;
   const uint32_t *next = g->next + g->first[i];
   __m256 d = _mm256_maskload_ps(z + (i & mask) * stride + at, heads);
   __m256 own = _mm256_maskload_ps(src + (i & mask) * stride, heads), most = own;
   for (j = 0; j + 1 < count; j++) {
      __m256 s = _mm256_maskload_ps(src + (next[j] & mask) * stride, heads);
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
DN__TARGET_AVX2 static DN__INLINE void dn__prefetch_avx2(const dn_graph *g, const float *z, size_t stride,
                                                         size_t mask, size_t i)
{
   size_t e, c;
   for (e = g->first[i]; e < g->first[i + 1]; e++)
      for (c = 0; g->next[e] > i && c < stride; c += 16)
         _mm_prefetch((const char *)(z + (g->next[e] & mask) * stride + c), _MM_HINT_T0);
}
DN__TARGET_AVX2 static void dn__attend_avx2(const dn_gat *b, const dn_graph *g, const float *z, size_t mask,
                                            float *y, size_t y_stride, size_t begin, size_t end)
{
   size_t stride = dn__gat_stride(b), kf = b->heads * b->features, i, j, c;
   const __m256i heads = dn__lanes_avx2(b->heads);
   float room[DN__WEIGHTS + 15], *e = dn__cache_line(room); /* (count,8) */
   for (i = begin; i < end; i++) {
      size_t count = (size_t)(g->first[i + 1] - g->first[i]) + 1;
      const uint32_t *next = g->next + g->first[i];
      const float *own = z + (i & mask) * stride;
      float *to = y + (i - begin) * y_stride;
      __m256 sum = _mm256_setzero_ps(), part;
      if (i + DN__AHEAD < end) dn__prefetch_avx2(g, z, stride, mask, i + DN__AHEAD);
      if (b->heads > 8 || count > DN__WEIGHTS / 8) {
         dn__attend_ref(b, g, z, mask, to, y_stride, i, i + 1);
         continue;
      }
      dn__logits_avx2(b, g, z, stride, mask, i, count, heads, e);
      for (j = 0; j < count; j++) {
         __m256 a = dn__exp_avx2(_mm256_loadu_ps(e + j * 8));
         _mm256_storeu_ps(e + j * 8, a);
         sum = _mm256_add_ps(sum, a);
      }
      part = _mm256_div_ps(_mm256_set1_ps(1.0f), sum);
      for (c = 0; c + 32 <= kf; c += 32) { /* four registers of columns: z_i + sum_j a_ij (z_j - z_i) */
         __m256i h0 = _mm256_loadu_si256((const __m256i *)(const void *)(b->head + c));
         __m256i h1 = _mm256_loadu_si256((const __m256i *)(const void *)(b->head + c + 8));
         __m256i h2 = _mm256_loadu_si256((const __m256i *)(const void *)(b->head + c + 16));
         __m256i h3 = _mm256_loadu_si256((const __m256i *)(const void *)(b->head + c + 24));
         __m256 z0 = _mm256_loadu_ps(own + c), z1 = _mm256_loadu_ps(own + c + 8);
         __m256 z2 = _mm256_loadu_ps(own + c + 16), z3 = _mm256_loadu_ps(own + c + 24);
         __m256 s0 = _mm256_setzero_ps(), s1 = s0, s2 = s0, s3 = s0, a;
         for (j = 1; j < count; j++) {
            const float *row = z + (next[j - 1] & mask) * stride + c;
            a = _mm256_loadu_ps(e + j * 8);
            s0 = _mm256_fmadd_ps(_mm256_permutevar8x32_ps(a, h0), _mm256_sub_ps(_mm256_loadu_ps(row), z0), s0);
            s1 = _mm256_fmadd_ps(_mm256_permutevar8x32_ps(a, h1), _mm256_sub_ps(_mm256_loadu_ps(row + 8), z1), s1);
            s2 = _mm256_fmadd_ps(_mm256_permutevar8x32_ps(a, h2), _mm256_sub_ps(_mm256_loadu_ps(row + 16), z2), s2);
            s3 = _mm256_fmadd_ps(_mm256_permutevar8x32_ps(a, h3), _mm256_sub_ps(_mm256_loadu_ps(row + 24), z3), s3);
         }
         s0 = _mm256_fmadd_ps(s0, _mm256_permutevar8x32_ps(part, h0), z0);
         s1 = _mm256_fmadd_ps(s1, _mm256_permutevar8x32_ps(part, h1), z1);
         s2 = _mm256_fmadd_ps(s2, _mm256_permutevar8x32_ps(part, h2), z2);
         s3 = _mm256_fmadd_ps(s3, _mm256_permutevar8x32_ps(part, h3), z3);
         _mm256_storeu_ps(to + c, dn__act_avx2(s0, b->activation));
         _mm256_storeu_ps(to + c + 8, dn__act_avx2(s1, b->activation));
         _mm256_storeu_ps(to + c + 16, dn__act_avx2(s2, b->activation));
         _mm256_storeu_ps(to + c + 24, dn__act_avx2(s3, b->activation));
      }
      for (; c < kf; c += 8) { /* and one; a row has room for whole registers, y has not */
         __m256i h = _mm256_loadu_si256((const __m256i *)(const void *)(b->head + c));
         __m256 zi = _mm256_loadu_ps(own + c), s = _mm256_setzero_ps();
         for (j = 1; j < count; j++)
            s = _mm256_fmadd_ps(_mm256_permutevar8x32_ps(_mm256_loadu_ps(e + j * 8), h),
                                _mm256_sub_ps(_mm256_loadu_ps(z + (next[j - 1] & mask) * stride + c), zi), s);
         s = _mm256_fmadd_ps(s, _mm256_permutevar8x32_ps(part, h), zi);
         _mm256_maskstore_ps(to + c, dn__lanes_avx2(kf - c), dn__act_avx2(s, b->activation));
      }
   }
}
static const dn__kernel dn__kernel_avx2 = { { 6, dn__tile_avx2 }, { 0, NULL }, dn__activate_avx2, dn__attend_avx2 };
#endif

#ifdef DN__HAS_AVX512
#define DN__WIDE(p) _mm512_castps256_ps512(_mm256_loadu_ps(p)) /* eight weights; the upper lanes are not drawn from */
#define DN__DRAW(head, a) _mm512_maskz_permutexvar_ps(DN__ALL, head, a) /* each column its head's weight */
DN__TARGET_AVX512 static void dn__attend_avx512(const dn_gat *b, const dn_graph *g, const float *z, size_t mask,
                                                float *y, size_t y_stride, size_t begin, size_t end)
{
   size_t stride = dn__gat_stride(b), kf = b->heads * b->features, i, j, c;
   const __m256i heads = dn__lanes_avx2(b->heads);
   float room[DN__WEIGHTS + 8 + 15], *e = dn__cache_line(room); /* (count,8) and one more */
   for (i = begin; i < end; i++) {
      size_t count = (size_t)(g->first[i + 1] - g->first[i]) + 1;
      const uint32_t *next = g->next + g->first[i];
      const float *own = z + (i & mask) * stride;
      float *to = y + (i - begin) * y_stride;
      __m256 sum = _mm256_setzero_ps();
      __m512 part;
      if (i + DN__AHEAD < end) dn__prefetch_avx2(g, z, stride, mask, i + DN__AHEAD);
      if (b->heads > 8 || count > DN__WEIGHTS / 8) {
         dn__attend_ref(b, g, z, mask, to, y_stride, i, i + 1);
         continue;
      }
      dn__logits_avx2(b, g, z, stride, mask, i, count, heads, e);
      _mm256_storeu_ps(e + count * 8, sum); /* so that the last 16 are numbers */
      for (j = 0; j < count; j += 2) { /* two neighbours; no load here spans two stores, that would stall */
         __m512 a = _mm512_insertf32x8(DN__WIDE(e + j * 8), _mm256_loadu_ps(e + j * 8 + 8), 1);
         _mm512_storeu_ps(e + j * 8, dn__exp_avx512(a));
      }
      for (j = 0; j < count; j++) sum = _mm256_add_ps(sum, _mm256_loadu_ps(e + j * 8));
      part = _mm512_castps256_ps512(_mm256_div_ps(_mm256_set1_ps(1.0f), sum));
      for (c = 0; c + 64 <= kf; c += 64) { /* four registers of columns: z_i + sum_j a_ij (z_j - z_i) */
         __m512i h0 = _mm512_loadu_si512(b->head + c), h1 = _mm512_loadu_si512(b->head + c + 16);
         __m512i h2 = _mm512_loadu_si512(b->head + c + 32), h3 = _mm512_loadu_si512(b->head + c + 48);
         __m512 z0 = _mm512_loadu_ps(own + c), z1 = _mm512_loadu_ps(own + c + 16);
         __m512 z2 = _mm512_loadu_ps(own + c + 32), z3 = _mm512_loadu_ps(own + c + 48);
         __m512 s0 = _mm512_setzero_ps(), s1 = s0, s2 = s0, s3 = s0, a;
         for (j = 1; j < count; j++) {
            const float *row = z + (next[j - 1] & mask) * stride + c;
            a = DN__WIDE(e + j * 8);
            s0 = _mm512_fmadd_ps(DN__DRAW(h0, a), _mm512_sub_ps(_mm512_loadu_ps(row), z0), s0);
            s1 = _mm512_fmadd_ps(DN__DRAW(h1, a), _mm512_sub_ps(_mm512_loadu_ps(row + 16), z1), s1);
            s2 = _mm512_fmadd_ps(DN__DRAW(h2, a), _mm512_sub_ps(_mm512_loadu_ps(row + 32), z2), s2);
            s3 = _mm512_fmadd_ps(DN__DRAW(h3, a), _mm512_sub_ps(_mm512_loadu_ps(row + 48), z3), s3);
         }
         s0 = _mm512_fmadd_ps(s0, DN__DRAW(h0, part), z0);
         s1 = _mm512_fmadd_ps(s1, DN__DRAW(h1, part), z1);
         s2 = _mm512_fmadd_ps(s2, DN__DRAW(h2, part), z2);
         s3 = _mm512_fmadd_ps(s3, DN__DRAW(h3, part), z3);
         _mm512_storeu_ps(to + c, dn__act_avx512(s0, b->activation));
         _mm512_storeu_ps(to + c + 16, dn__act_avx512(s1, b->activation));
         _mm512_storeu_ps(to + c + 32, dn__act_avx512(s2, b->activation));
         _mm512_storeu_ps(to + c + 48, dn__act_avx512(s3, b->activation));
      }
      for (; c < kf; c += 16) { /* and one; a row has room for whole registers, y has not */
         __m512i h = _mm512_loadu_si512(b->head + c);
         __m512 zi = _mm512_loadu_ps(own + c), s = _mm512_setzero_ps();
         for (j = 1; j < count; j++)
            s = _mm512_fmadd_ps(DN__DRAW(h, DN__WIDE(e + j * 8)),
                                _mm512_sub_ps(_mm512_loadu_ps(z + (next[j - 1] & mask) * stride + c), zi), s);
         s = _mm512_fmadd_ps(s, DN__DRAW(h, part), zi);
         _mm512_mask_storeu_ps(to + c, dn__lanes_avx512(kf - c), dn__act_avx512(s, b->activation));
      }
   }
}
#undef DN__WIDE
#undef DN__DRAW
static const dn__kernel dn__kernel_avx512 = { { 14, dn__tile1_avx512 }, { 7, dn__tile2_avx512 }, dn__activate_avx512,
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
static void dn__attend_f4(const dn_gat *b, const dn_graph *g, const float *z, size_t mask, float *y, size_t y_stride,
                          size_t begin, size_t end)
{
   size_t stride = dn__gat_stride(b), kf = b->heads * b->features, i, j, k, c;
   int one = b->features % 4 == 0;
   float e[DN__WEIGHTS]; /* (count,heads) and 1 / sum (heads); heads rounded up to whole registers */
   size_t pitch = dn__round(b->heads, 4), most_count = DN__WEIGHTS / pitch;
   for (i = begin; i < end; i++) {
      size_t count = (size_t)(g->first[i + 1] - g->first[i]) + 1;
      const uint32_t *next = g->next + g->first[i];
      const float *own = z + (i & mask) * stride, *dst = own + kf; /* (K) dst . z_i, then (K) src . z_i */
      float *to = y + (i - begin) * y_stride, *part;
      if (count >= most_count) {
         dn__attend_ref(b, g, z, mask, to, y_stride, i, i + 1);
         continue;
      }
      part = e + count * pitch;
      memset(e, 0, (count + 1) * pitch * sizeof(float));
      for (j = 0; j < count; j++) {
         const float *src = z + ((j ? next[j - 1] : i) & mask) * stride + kf + b->heads;
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
      for (c = 0; c < kf; c += 4) { /* z_i + sum_j a_ij (z_j - z_i); a row has room for whole registers, y has not */
         dn__f4 zi = dn__f4_load(own + c), s = dn__f4_all(0.0f);
         for (j = 1; j < count; j++)
            s = dn__f4_fma(dn__draw_f4(e + j * pitch, b->head + c, one),
                           dn__f4_sub(dn__f4_load(z + (next[j - 1] & mask) * stride + c), zi), s);
         s = dn__f4_fma(s, dn__draw_f4(part, b->head + c, one), zi);
         dn__store_f4(to + c, kf - c, dn__act_f4(s, b->activation));
      }
   }
}
static const dn__kernel dn__kernel_f4 = { { DN__F4_ROWS, dn__tile_f4 }, { 0, NULL }, dn__activate_f4, dn__attend_f4 };
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
   dn__attend_ref(block, g, z, SIZE_MAX, y, y_stride, 0, g->nodes);
}
typedef struct dn__gat_job {
   const dn_gat *block;
   const dn_graph *g;
   const float *v;
   float *z, *y;
   size_t v_stride, y_stride;
} dn__gat_job;
/* both products as one: z (rows,stride); y: rows of the block's output, of which the columns c are written */
static void dn__gat_rows(const dn_gat *b, const float *v, size_t v_stride, float *z, float *y, size_t y_stride,
                         size_t begin, size_t end)
{
   dn_linear z_of = dn__gat_z(b), c_of = dn__gat_c(b), both = z_of;
   float *c = y + b->heads * b->features;
   if (dn__kernel_of(b->kernel)) {
      both.out += c_of.out;
      both.activation = c_of.activation;
      dn__product_split(&both, v, v_stride, z, z_of.out, z_of.out, c, y_stride, begin, end);
   } else {
      dn__product_ref(&z_of, v, v_stride, z, z_of.out, begin, end);
      dn__product_ref(&c_of, v, v_stride, c, y_stride, begin, end);
   }
}
static void dn__gat_products(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__gat_job *j = (const dn__gat_job *)job;
   (void)worker;
   dn__gat_rows(j->block, j->v, j->v_stride, j->z, j->y, j->y_stride, begin, end);
}
static void dn__gat_attend(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__gat_job *j = (const dn__gat_job *)job;
   const dn__kernel *k = dn__kernel_of(j->block->kernel);
   (void)worker;
   (k ? k->attend : dn__attend_ref)(j->block, j->g, j->z, SIZE_MAX, j->y + begin * j->y_stride, j->y_stride, begin, end);
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
         float most = dn__logit_most(g, dst, src, stride, SIZE_MAX, i), sum = 0;
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
DN_API void dn_dense_ref(const dn_gat *blocks, size_t count, const dn_graph *g, float *rows, size_t row_stride,
                         size_t width, void *scratch)
{
   size_t b;
   float *x = rows + (count ? width - blocks[0].in : 0); /* x_b, in + made before it wide */
   for (b = 0; b < count; b++) {
      float *f = x - (blocks[b].heads * blocks[b].features + blocks[b].self);
      dn_gat_ref(&blocks[b], g, x, row_stride, f, row_stride, scratch);
      x = f; /* x_{b+1} = f_b(x_b) || x_b: where f starts */
   }
}
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

/* ===================================================================================== >>reduced
   in       rows of cells (bfloat16, 8-bit or float32), one layer or block packed at that precision
   out      rows of cells; of a block also its z, IEEE half (float32 where weights alone are reduced)
   touches  nothing but what it is told to write: no allocation, no statics
   read     dn__tile_ref, dn__finish_ref, dn__reduced_attend_ref first; every fast text below is one of these again

   precision   weights               rows                  sums
   f16         half                  float32               float32: as in >>kernels, at half the memory
   bf16        bfloat16              bfloat16              float32
   int8        8 bits, a scale for   8 bits, a range for   int32, exact: |sum| < 127^2 2^16 (DN_MAX_DIM) fits
               each output           each column

   A column of 8-bit cells stands for  x = middle + step (cell - 128),  cell = 1 .. 255  (0 in tests alone). Per output o

        sum_c W_oc x_c = sum_c W_oc middle_c + sum_c (W_oc step_c) (cell_c - 128)
                         `---- start_o ----'         `- scale_o w_oc -'

   w_oc the nearest whole number within +-127; sum_c w_oc (cell_c - 128) = sum_c w_oc cell_c - 128 sum_c w_oc, the last of
   which is packed as `minus`, since what multiplies 8 bits fastest (vpdpbusd) takes cells without a sign. Batch norm joins
   scale and start.
   The int32 sums are the same in every text. So are the steps in floats after them (scale, activation, attention, the next
   rounding to cells): one order, each product rounded before it is added, no fused multiply-add, polynomials of the four
   operations. A block of 8-bit rows gives the same bits in every kernel. */
typedef enum dn__cell { DN__FLOAT, DN__HALF, DN__BF16, DN__BYTE } dn__cell;
static size_t dn__cell_size(dn__cell cell) { return cell == DN__FLOAT ? 4 : cell == DN__BYTE ? 1 : 2; }

static size_t dn__precision_size(dn_precision precision) { return precision == DN_PRECISION_INT8 ? 1 : 2; } /* of a weight */
static dn__cell dn__precision_cell(dn_precision precision) /* of rows */
{
   return precision == DN_PRECISION_INT8 ? DN__BYTE : precision == DN_PRECISION_BF16 ? DN__BF16 : DN__FLOAT;
}

typedef struct dn__reduced_text dn__reduced_text;
typedef struct dn__reduced { /* a linear layer (heads 0) or a GAT block */
   dn_precision precision;
   const dn__reduced_text *text;
   size_t in, out, heads, features, self; /* out = heads features + self; of a linear layer, self = out */
   dn_activation activation;   /* not softmax */
   dn__cell from, to;          /* of the rows read and written */
   dn__cell z;                 /* of a block's z: half, its logits float; or float, logits among them as in >>attention */
   size_t z_panels, panels;    /* z panels, logits' panels, then those of the columns written to y */
   const unsigned char *weights; /* (panels, in rounded up to the group, 16): groups of terms, see dn__reduced_at */
   const float *columns;       /* (panels, 2, 16) scale, shift: y = act(sum scale + shift) */
   const int32_t *minus;       /* (panels, 16) -128 sum_c w; 8 bits only, else NULL */
   const uint32_t *head;       /* (z_panels 16) the head of each column of z */
   const float *inverse, *offset; /* (out + at least 16) cell = nearest(y inverse + offset) of 8-bit rows written */
} dn__reduced;
struct dn__reduced_text {
   size_t group;  /* terms that lie side by side in a panel */
   size_t rows;   /* of a tile */
   size_t panels; /* side by side, at most */
   size_t cell;   /* bytes of a row's term as the tile reads it; wider than the row's own cell: `widen` makes them */
   /* count terms from x -> to (rows, count rounded up to the group) */
   void (*widen)(const unsigned char *x, size_t pitch, size_t rows, size_t count, unsigned char *to, size_t to_pitch);
   /* sums (panels, rows, 16) float or int32 over `in` terms; w_pitch bytes from panel to panel; minus: what 8-bit sums
      start from; more: they go on from what is there */
   void (*tile)(const unsigned char *x, size_t pitch, size_t in, const unsigned char *w, size_t w_pitch,
                const int32_t *minus, int more, size_t panels, void *sums);
   /* cells of sums (rows,16): y (rows, count <= 16) */
   void (*finish)(const void *sums, int whole, const float *columns, dn_activation activation, size_t rows,
                  unsigned char *y, size_t pitch, size_t count, dn__cell cell, const float *inverse, const float *offset);
   /* count numbers of a row as cells */
   void (*cells)(const float *x, size_t count, unsigned char *y, dn__cell cell, const float *inverse, const float *offset);
   /* z of node n is row (n & mask), y starts with node `begin` */
   void (*attend)(const dn__reduced *b, const dn_graph *g, const unsigned char *z, size_t z_pitch, size_t mask,
                  unsigned char *y, size_t y_pitch, size_t begin, size_t end);
};
enum { DN__WIDENED = 224, DN__REDUCED_ROWS = 14 }; /* terms that `widen` makes at a time; rows of the highest tile */
typedef struct dn__span { /* what the 8-bit cells of a row's columns stand for: (width) each; NULL while measuring */
   size_t width;
   const float *middle, *step, *inverse, *offset; /* the last two (width + at least 16), see dn__reduced */
} dn__span;

/* --- single numbers. A product that must be rounded before it is added passes dn__times: compilers may fuse the two, gcc
   even where both are intrinsics. */
#if defined(__GNUC__) || defined(__clang__)
   #define DN__ROUNDED(x, where) __asm__("" : "+" where(x))
#else
   #define DN__ROUNDED(x, where) (void)0
#endif
static float dn__times(float a, float b)
{
   float p = a * b;
   DN__ROUNDED(p, "m");
   return p;
}
static float dn__plus(float a, float b) /* the same of a sum, where registers are wider than a float (x87) */
{
   float s = a + b;
   DN__ROUNDED(s, "m");
   return s;
}
static float dn__float_of(uint32_t bits)
{
   float x;
   memcpy(&x, &bits, 4);
   return x;
}
static uint32_t dn__bits_of(float x)
{
   uint32_t u;
   memcpy(&u, &x, 4);
   return u;
}
static unsigned dn__half_of(float x) /* to the nearest half, ties to even; beyond 65504 saturates, NaN stays NaN */
{
   uint32_t u, sign;
   if (dn__nan(x)) return 0x7e00u;
   x = x > 65504.0f ? 65504.0f : x < -65504.0f ? -65504.0f : x;
   u = dn__bits_of(x);
   sign = u >> 16 & 0x8000u;
   u &= 0x7fffffffu;
   if (u < 0x38800000u) /* 2^-14: below, a half counts 2^-24s, which are the last bits of a float that begins at 0.5 */
      return sign | (dn__bits_of(dn__plus(dn__float_of(u), 0.5f)) - 0x3f000000u);
   return sign | ((u + 0xc8000fffu + (u >> 13 & 1u)) >> 13);
}
static unsigned dn__bf16_of(float x) /* to the nearest, ties to even; NaN stays NaN */
{
   uint32_t u = dn__bits_of(x);
   if (dn__nan(x)) return 0x7fc0u;
   return (u + 0x7fffu + (u >> 16 & 1u)) >> 16;
}
#define DN__WHOLE 12582912.0f /* 1.5 2^23: adding it rounds |x| < 2^22 to a whole number, ties to even */
static unsigned dn__byte_of(float y, float inverse, float offset) /* 1 .. 255; NaN gives 1 */
{
   float t = dn__plus(dn__times(y, inverse), offset);
   t = t > 1.0f ? t : 1.0f;
   t = t < 255.0f ? t : 255.0f;
   return dn__bits_of(dn__plus(t, DN__WHOLE)) & 0xffu;
}
static uint32_t dn__read16(const unsigned char *p)
{
   uint16_t h;
   memcpy(&h, p, 2);
   return h;
}
static float dn__read_cell(const unsigned char *p, dn__cell cell) /* of 8 bits, the cell itself */
{
   float x;
   switch (cell) {
   case DN__HALF: return dn__float_of(dn__half_bits(dn__read16(p)));
   case DN__BF16: return dn__float_of(dn__read16(p) << 16);
   case DN__BYTE: return (float)*p;
   case DN__FLOAT:
   default: memcpy(&x, p, 4); return x;
   }
}
static void dn__write_cell(unsigned char *p, float x, dn__cell cell, const float *inverse, const float *offset)
{
   uint16_t h;
   switch (cell) {
   case DN__HALF: h = (uint16_t)dn__half_of(x); memcpy(p, &h, 2); break;
   case DN__BF16: h = (uint16_t)dn__bf16_of(x); memcpy(p, &h, 2); break;
   case DN__BYTE: *p = (unsigned char)dn__byte_of(x, *inverse, *offset); break;
   case DN__FLOAT:
   default: memcpy(p, &x, 4); break;
   }
}

/* exp(x), x <= 0: 2^n 2^f with n the nearest whole number to t = x log2 e and a polynomial in f, |f| <= 1/2, exactly 1 at
   0. Relative error below 4e-6, a hundredth of what halves lose. Below 2^-126 it stays there, which adds nothing. */
#define DN__EXP2_1 0.6931241750717163f
#define DN__EXP2_2 0.24024099111557007f
#define DN__EXP2_3 0.055906426161527634f
#define DN__EXP2_4 0.009582852944731712f
#define DN__EXP2_LOW (-126.0f)
static float dn__reduced_exp(float x)
{
   float t = dn__times(x, DN__LOG2E), m, f, p;
   t = t > DN__EXP2_LOW ? t : DN__EXP2_LOW;
   m = dn__plus(t, DN__WHOLE); /* its last bits are n */
   f = dn__plus(t, -dn__plus(m, -DN__WHOLE));
   p = dn__plus(dn__times(DN__EXP2_4, f), DN__EXP2_3);
   p = dn__plus(dn__times(p, f), DN__EXP2_2);
   p = dn__plus(dn__times(p, f), DN__EXP2_1);
   p = dn__plus(dn__times(p, f), 1.0f);
   return dn__times(p, dn__float_of((dn__bits_of(m) << 23) + 0x3f800000u));
}
/* x - tanh x = x^3 (a0 + a1 x^2) / (1 + b1 x^2 + b2 x^4) for |x| <= 4.5, relative error 3e-5; from there on it goes on with
   slope 1: tanh 4.5 = 0.99975. tanh is what remains. The errors are a hundredth of the rounding to bfloat16. */
#define DN__SHRINK_MOST 4.5f
#define DN__SHRINK_A0 0.333324f
#define DN__SHRINK_A1 0.01317175f
#define DN__SHRINK_B1 0.43938641f
#define DN__SHRINK_B2 0.01396017f
static float dn__reduced_tanh(float x, int shrink)
{
   float c = x < DN__SHRINK_MOST ? x : dn__nan(x) ? x : DN__SHRINK_MOST, z, s, d;
   c = c < -DN__SHRINK_MOST ? -DN__SHRINK_MOST : c;
   z = dn__times(c, c);
   s = dn__times(dn__times(c, z), dn__plus(dn__times(z, DN__SHRINK_A1), DN__SHRINK_A0));
   d = dn__plus(dn__times(dn__plus(dn__times(z, DN__SHRINK_B2), DN__SHRINK_B1), z), 1.0f);
   s = s / d;
   DN__ROUNDED(s, "m");
   return shrink ? dn__plus(s, dn__plus(x, -c)) : dn__plus(c, -s);
}
static float dn__reduced_leaky(float x) { return x < 0 ? dn__times(0.2f, x) : x; }
static float dn__reduced_activate(float x, dn_activation activation)
{
   switch (activation) {
   case DN_ACT_TANH: return dn__reduced_tanh(x, 0);
   case DN_ACT_TANHSHRINK: return dn__reduced_tanh(x, 1);
   case DN_ACT_LEAKYRELU: return dn__reduced_leaky(x);
   case DN_ACT_RELU: return x < 0 ? 0 : x;
   case DN_ACT_NONE:
   case DN_ACT_SOFTMAX:
   default: return x;
   }
}

/* --- the plain texts */
/* Where term c of a column lies in its panel, in terms: groups of `group` terms, in each of them column by column */
static size_t dn__reduced_at(size_t group, size_t column, size_t c)
{
   return (c / group * DN_PANEL + column) * group + c % group;
}
static void dn__tile_ref_bytes(const unsigned char *x, size_t pitch, size_t in, const unsigned char *w, size_t w_pitch,
                               const int32_t *minus, int more, size_t panels, void *sums)
{
   int32_t *to = (int32_t *)sums;
   size_t o, c;
   (void)pitch, (void)w_pitch, (void)more, (void)panels;
   for (o = 0; o < DN_PANEL; o++) {
      uint32_t sum = (uint32_t)minus[o]; /* on its way the sum may wrap; in the end it fits */
      for (c = 0; c < in; c++) sum += (uint32_t)((int32_t)x[c] * (int32_t)(signed char)w[c * DN_PANEL + o]);
      memcpy(to + o, &sum, 4);
   }
}
static void dn__tile_ref_floats(const unsigned char *x, dn__cell cell, size_t in, const unsigned char *w, dn__cell weight,
                                float *sums)
{
   size_t o, c;
   for (o = 0; o < DN_PANEL; o++) {
      double sum = 0;
      for (c = 0; c < in; c++)
         sum += (double)dn__read_cell(x + c * dn__cell_size(cell), cell) *
            (double)dn__read_cell(w + 2 * (c * DN_PANEL + o), weight);
      sums[o] = dn__narrow(sum);
   }
}
static void dn__tile_ref_bf16(const unsigned char *x, size_t pitch, size_t in, const unsigned char *w, size_t w_pitch,
                              const int32_t *minus, int more, size_t panels, void *sums)
{
   (void)pitch, (void)w_pitch, (void)minus, (void)more, (void)panels;
   dn__tile_ref_floats(x, DN__BF16, in, w, DN__BF16, (float *)sums);
}
static void dn__tile_ref_half(const unsigned char *x, size_t pitch, size_t in, const unsigned char *w, size_t w_pitch,
                              const int32_t *minus, int more, size_t panels, void *sums)
{
   (void)pitch, (void)w_pitch, (void)minus, (void)more, (void)panels;
   dn__tile_ref_floats(x, DN__FLOAT, in, w, DN__HALF, (float *)sums);
}
static void dn__finish_ref(const void *sums, int whole, const float *columns, dn_activation activation, size_t rows,
                           unsigned char *y, size_t pitch, size_t count, dn__cell cell, const float *inverse,
                           const float *offset)
{
   size_t r, o;
   for (r = 0; r < rows; r++)
      for (o = 0; o < count; o++) {
         size_t at = r * DN_PANEL + o;
         float u = whole ? dn__plus((float)((const int32_t *)sums)[at], 0.0f) : ((const float *)sums)[at];
         u = dn__plus(dn__times(u, columns[o]), columns[DN_PANEL + o]);
         dn__write_cell(y + r * pitch + o * dn__cell_size(cell), dn__reduced_activate(u, activation), cell,
                        inverse ? inverse + o : NULL, offset ? offset + o : NULL);
      }
}
static void dn__cells_ref(const float *x, size_t count, unsigned char *y, dn__cell cell, const float *inverse, const float *offset)
{
   size_t c;
   for (c = 0; c < count; c++)
      dn__write_cell(y + c * dn__cell_size(cell), x[c], cell, inverse ? inverse + c : NULL, offset ? offset + c : NULL);
}
static size_t dn__logits_at(const dn__reduced *b) { return b->z_panels * DN_PANEL * 2; } /* bytes from a row's start */
/* y_i = act( sum_j e_ij z_j / sum_j e_ij ), e_ij = exp(leaky(dst . z_i + src . z_j) - max): dn__attend_ref on halves. The
   differences that it takes for the sake of float32's last digits would be lost here. */
static void dn__reduced_attend_ref(const dn__reduced *b, const dn_graph *g, const unsigned char *z, size_t z_pitch,
                                   size_t mask, unsigned char *y, size_t y_pitch, size_t begin, size_t end)
{
   size_t i, j, k, f, size = dn__cell_size(b->to);
   for (i = begin; i < end; i++) {
      size_t count = (size_t)(g->first[i + 1] - g->first[i]) + 1;
      for (k = 0; k < b->heads; k++) {
         const unsigned char *dst = z + dn__logits_at(b) + 4 * k, *src = dst + 4 * b->heads; /* rows z_pitch apart */
         float own = dn__read_cell(dst + (i & mask) * z_pitch, DN__FLOAT), most = 0;
         for (j = 0; j < count; j++) {
            float s = dn__read_cell(src + (dn__member(g, i, j) & mask) * z_pitch, DN__FLOAT);
            most = j == 0 || s > most ? s : most;
         }
         most = dn__reduced_leaky(dn__plus(own, most));
         for (f = 0; f < b->features; f++) {
            size_t c = k * b->features + f;
            float all = 0, sum = 0;
            for (j = 0; j < count; j++) {
               const unsigned char *row = z + (dn__member(g, i, j) & mask) * z_pitch;
               float s = dn__read_cell(src + (dn__member(g, i, j) & mask) * z_pitch, DN__FLOAT);
               float e = dn__reduced_exp(dn__plus(dn__reduced_leaky(dn__plus(own, s)), -most));
               all = dn__plus(all, e);
               sum = dn__plus(sum, dn__times(e, dn__read_cell(row + 2 * c, DN__HALF)));
            }
            all = 1.0f / all;
            DN__ROUNDED(all, "m");
            dn__write_cell(y + (i - begin) * y_pitch + c * size, dn__reduced_activate(dn__times(sum, all), b->activation),
                           b->to, b->inverse ? b->inverse + c : NULL, b->offset ? b->offset + c : NULL);
         }
      }
   }
}

/* --- the fast texts of the steps in floats: one text over the operations of a register type v16, v8 or v4 (AVX-512; AVX2;
   SSE2, NEON or WebAssembly), so that all of them are the same to the last bit. Of max and min the second operand counts
   where one is NaN. */
#ifdef DN__HAS_AVX2
typedef __m256 dn__v8;
DN__TARGET_AVX2 static DN__INLINE dn__v8 dn__v8_load(const float *p) { return _mm256_loadu_ps(p); }
DN__TARGET_AVX2 static DN__INLINE void dn__v8_store(float *p, dn__v8 a) { _mm256_storeu_ps(p, a); }
DN__TARGET_AVX2 static DN__INLINE dn__v8 dn__v8_all(float a) { return _mm256_set1_ps(a); }
DN__TARGET_AVX2 static DN__INLINE dn__v8 dn__v8_add(dn__v8 a, dn__v8 b) { return _mm256_add_ps(a, b); }
DN__TARGET_AVX2 static DN__INLINE dn__v8 dn__v8_sub(dn__v8 a, dn__v8 b) { return _mm256_sub_ps(a, b); }
DN__TARGET_AVX2 static DN__INLINE dn__v8 dn__v8_mul(dn__v8 a, dn__v8 b)
{
   a = _mm256_mul_ps(a, b);
   DN__ROUNDED(a, "x");
   return a;
}
DN__TARGET_AVX2 static DN__INLINE dn__v8 dn__v8_div(dn__v8 a, dn__v8 b) { return _mm256_div_ps(a, b); }
DN__TARGET_AVX2 static DN__INLINE dn__v8 dn__v8_max(dn__v8 a, dn__v8 b) { return _mm256_max_ps(a, b); }
DN__TARGET_AVX2 static DN__INLINE dn__v8 dn__v8_min(dn__v8 a, dn__v8 b) { return _mm256_min_ps(a, b); }
DN__TARGET_AVX2 static DN__INLINE dn__v8 dn__v8_power(dn__v8 m) /* 2^n from n + DN__WHOLE */
{
   __m256i n = _mm256_slli_epi32(_mm256_castps_si256(m), 23);
   return _mm256_castsi256_ps(_mm256_add_epi32(n, _mm256_set1_epi32(0x3f800000)));
}
DN__TARGET_AVX2 static DN__INLINE dn__v8 dn__v8_ints(const int32_t *p)
{
   return _mm256_cvtepi32_ps(_mm256_loadu_si256((const __m256i *)(const void *)p));
}
DN__TARGET_AVX2 static DN__INLINE dn__v8 dn__v8_halves(const unsigned char *p)
{
   return _mm256_cvtph_ps(_mm_loadu_si128((const __m128i *)(const void *)p));
}
DN__TARGET_AVX2 static DN__INLINE void dn__v8_put_halves(unsigned char *p, dn__v8 a)
{
   _mm_storeu_si128((__m128i *)(void *)p, _mm256_cvtps_ph(a, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC));
}
DN__TARGET_AVX2 static DN__INLINE void dn__v8_put_bf16(unsigned char *p, dn__v8 a) /* dn__bf16_of */
{
   __m256i u = _mm256_castps_si256(a), odd = _mm256_and_si256(_mm256_srli_epi32(u, 16), _mm256_set1_epi32(1));
   __m256i none = _mm256_castps_si256(_mm256_cmp_ps(a, a, _CMP_UNORD_Q));
   u = _mm256_add_epi32(_mm256_add_epi32(u, _mm256_set1_epi32(0x7fff)), odd);
   u = _mm256_srli_epi32(_mm256_blendv_epi8(u, _mm256_set1_epi32(0x7fc00000), none), 16);
   _mm_storeu_si128((__m128i *)(void *)p, _mm_packus_epi32(_mm256_castsi256_si128(u), _mm256_extracti128_si256(u, 1)));
}
DN__TARGET_AVX2 static DN__INLINE void dn__v8_put_bytes(unsigned char *p, dn__v8 a) /* whole, 0 .. 255 */
{
   __m256i u = _mm256_cvtps_epi32(a);
   __m128i h = _mm_packs_epi32(_mm256_castsi256_si128(u), _mm256_extracti128_si256(u, 1));
   _mm_storel_epi64((__m128i *)(void *)p, _mm_packus_epi16(h, h));
}
typedef struct dn__v8_heads { __m256i h; int same; } dn__v8_heads;
DN__TARGET_AVX2 static DN__INLINE dn__v8_heads dn__v8_head(const uint32_t *head, size_t features)
{
   dn__v8_heads h;
   h.h = _mm256_loadu_si256((const __m256i *)(const void *)head);
   h.same = 0;
   (void)features;
   return h;
}
DN__TARGET_AVX2 static DN__INLINE dn__v8 dn__v8_draw(const float *e, dn__v8_heads h) /* e of each column's head */
{
   return _mm256_permutevar8x32_ps(_mm256_loadu_ps(e), h.h);
}
#endif
#ifdef DN__HAS_AVX512
typedef __m512 dn__v16;
DN__TARGET_AVX512 static DN__INLINE dn__v16 dn__v16_load(const float *p) { return _mm512_loadu_ps(p); }
DN__TARGET_AVX512 static DN__INLINE void dn__v16_store(float *p, dn__v16 a) { _mm512_storeu_ps(p, a); }
DN__TARGET_AVX512 static DN__INLINE dn__v16 dn__v16_all(float a) { return _mm512_set1_ps(a); }
DN__TARGET_AVX512 static DN__INLINE dn__v16 dn__v16_add(dn__v16 a, dn__v16 b) { return _mm512_add_ps(a, b); }
DN__TARGET_AVX512 static DN__INLINE dn__v16 dn__v16_sub(dn__v16 a, dn__v16 b) { return _mm512_sub_ps(a, b); }
DN__TARGET_AVX512 static DN__INLINE dn__v16 dn__v16_mul(dn__v16 a, dn__v16 b)
{
   a = _mm512_mul_ps(a, b);
   DN__ROUNDED(a, "v");
   return a;
}
DN__TARGET_AVX512 static DN__INLINE dn__v16 dn__v16_div(dn__v16 a, dn__v16 b) { return _mm512_div_ps(a, b); }
DN__TARGET_AVX512 static DN__INLINE dn__v16 dn__v16_max(dn__v16 a, dn__v16 b) { return _mm512_maskz_max_ps(DN__ALL, a, b); }
DN__TARGET_AVX512 static DN__INLINE dn__v16 dn__v16_min(dn__v16 a, dn__v16 b) { return _mm512_maskz_min_ps(DN__ALL, a, b); }
DN__TARGET_AVX512 static DN__INLINE dn__v16 dn__v16_power(dn__v16 m)
{
   __m512i n = _mm512_maskz_slli_epi32(DN__ALL, _mm512_castps_si512(m), 23);
   return _mm512_castsi512_ps(_mm512_add_epi32(n, _mm512_set1_epi32(0x3f800000)));
}
DN__TARGET_AVX512 static DN__INLINE dn__v16 dn__v16_ints(const int32_t *p)
{
   return _mm512_maskz_cvtepi32_ps(DN__ALL, _mm512_loadu_si512(p));
}
DN__TARGET_AVX512 static DN__INLINE dn__v16 dn__v16_halves(const unsigned char *p)
{
   return _mm512_maskz_cvtph_ps(DN__ALL, _mm256_loadu_si256((const __m256i *)(const void *)p));
}
DN__TARGET_AVX512 static DN__INLINE void dn__v16_put_halves(unsigned char *p, dn__v16 a)
{
   _mm256_storeu_si256((__m256i *)(void *)p,
                       _mm512_maskz_cvtps_ph(DN__ALL, a, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC));
}
DN__TARGET_AVX512 static DN__INLINE void dn__v16_put_bf16(unsigned char *p, dn__v16 a)
{
   __m512i u = _mm512_castps_si512(a), odd;
   __mmask16 none = _mm512_cmp_ps_mask(a, a, _CMP_UNORD_Q);
   odd = _mm512_and_si512(_mm512_maskz_srli_epi32(DN__ALL, u, 16), _mm512_set1_epi32(1));
   u = _mm512_add_epi32(_mm512_add_epi32(u, _mm512_set1_epi32(0x7fff)), odd);
   u = _mm512_mask_mov_epi32(u, none, _mm512_set1_epi32(0x7fc00000));
   u = _mm512_maskz_srli_epi32(DN__ALL, u, 16);
   _mm256_storeu_si256((__m256i *)(void *)p, _mm512_maskz_cvtepi32_epi16(DN__ALL, u));
}
DN__TARGET_AVX512 static DN__INLINE void dn__v16_put_bytes(unsigned char *p, dn__v16 a)
{
   _mm_storeu_si128((__m128i *)(void *)p, _mm512_maskz_cvtepi32_epi8(DN__ALL, _mm512_maskz_cvtps_epi32(DN__ALL, a)));
}
typedef struct dn__v16_heads { __m512i h; int same; } dn__v16_heads;
DN__TARGET_AVX512 static DN__INLINE dn__v16_heads dn__v16_head(const uint32_t *head, size_t features)
{
   dn__v16_heads h;
   h.h = _mm512_loadu_si512(head);
   h.same = 0;
   (void)features;
   return h;
}
DN__TARGET_AVX512 static DN__INLINE dn__v16 dn__v16_draw(const float *e, dn__v16_heads h)
{
   return _mm512_maskz_permutexvar_ps(DN__ALL, h.h, _mm512_castps256_ps512(_mm256_loadu_ps(e)));
}
#endif
#ifdef DN__HAS_F4
/* whole numbers, four lanes */
   #if defined(DN__F4_NEON)
typedef int32x4_t dn__i4;
static DN__INLINE dn__i4 dn__i4_of(dn__f4 a) { return vreinterpretq_s32_f32(a); }
static DN__INLINE dn__f4 dn__i4_bits(dn__i4 a) { return vreinterpretq_f32_s32(a); }
static DN__INLINE dn__i4 dn__i4_load(const void *p) { return vld1q_s32((const int32_t *)p); }
static DN__INLINE void dn__i4_store(void *p, dn__i4 a) { vst1q_s32((int32_t *)p, a); }
static DN__INLINE dn__i4 dn__i4_all(int a) { return vdupq_n_s32(a); }
static DN__INLINE dn__i4 dn__i4_add(dn__i4 a, dn__i4 b) { return vaddq_s32(a, b); }
static DN__INLINE dn__i4 dn__i4_and(dn__i4 a, dn__i4 b) { return vandq_s32(a, b); }
static DN__INLINE dn__i4 dn__i4_or(dn__i4 a, dn__i4 b) { return vorrq_s32(a, b); }
static DN__INLINE dn__i4 dn__i4_up(dn__i4 a, int n) { return vshlq_s32(a, vdupq_n_s32(n)); }
static DN__INLINE dn__i4 dn__i4_down(dn__i4 a, int n) /* zeros come in */
{
   return vreinterpretq_s32_u32(vshlq_u32(vreinterpretq_u32_s32(a), vdupq_n_s32(-n)));
}
static DN__INLINE dn__i4 dn__i4_more(dn__i4 a, dn__i4 b) { return vreinterpretq_s32_u32(vcgtq_s32(a, b)); }
static DN__INLINE dn__f4 dn__i4_float(dn__i4 a) { return vcvtq_f32_s32(a); }
static DN__INLINE dn__i4 dn__i4_nearest(dn__f4 a) { return vcvtnq_s32_f32(a); }
static DN__INLINE dn__i4 dn__i4_load16(const unsigned char *p)
{
   return vreinterpretq_s32_u32(vmovl_u16(vreinterpret_u16_u8(vld1_u8(p))));
}
static DN__INLINE void dn__i4_store16(unsigned char *p, dn__i4 a)
{
   vst1_u8(p, vreinterpret_u8_u16(vmovn_u32(vreinterpretq_u32_s32(a))));
}
static DN__INLINE dn__f4 dn__f4_rounded(dn__f4 a)
{
   DN__ROUNDED(a, "w");
   return a;
}
/* eight products of terms of 16 bits, side by side pairs added: sum of (4) pairs */
static DN__INLINE dn__i4 dn__i4_pairs(dn__i4 sum, dn__i4 x, dn__i4 w)
{
   int16x8_t a = vreinterpretq_s16_s32(x), b = vreinterpretq_s16_s32(w);
   int32x4_t low = vmull_s16(vget_low_s16(a), vget_low_s16(b)), high = vmull_s16(vget_high_s16(a), vget_high_s16(b));
   return vaddq_s32(sum, vcombine_s32(vpadd_s32(vget_low_s32(low), vget_high_s32(low)),
                                      vpadd_s32(vget_low_s32(high), vget_high_s32(high))));
}
static DN__INLINE void dn__i4_widen8(const unsigned char *p, dn__i4 *low, dn__i4 *high) /* 16 signed bytes to 16 bits each */
{
   int8x16_t b = vreinterpretq_s8_u8(vld1q_u8(p));
   *low = vreinterpretq_s32_s16(vmovl_s8(vget_low_s8(b)));
   *high = vreinterpretq_s32_s16(vmovl_s8(vget_high_s8(b)));
}
   #elif defined(DN__F4_WASM)
typedef v128_t dn__i4;
static DN__INLINE dn__i4 dn__i4_of(dn__f4 a) { return a; }
static DN__INLINE dn__f4 dn__i4_bits(dn__i4 a) { return a; }
static DN__INLINE dn__i4 dn__i4_load(const void *p) { return wasm_v128_load(p); }
static DN__INLINE void dn__i4_store(void *p, dn__i4 a) { wasm_v128_store(p, a); }
static DN__INLINE dn__i4 dn__i4_all(int a) { return wasm_i32x4_splat(a); }
static DN__INLINE dn__i4 dn__i4_add(dn__i4 a, dn__i4 b) { return wasm_i32x4_add(a, b); }
static DN__INLINE dn__i4 dn__i4_and(dn__i4 a, dn__i4 b) { return wasm_v128_and(a, b); }
static DN__INLINE dn__i4 dn__i4_or(dn__i4 a, dn__i4 b) { return wasm_v128_or(a, b); }
static DN__INLINE dn__i4 dn__i4_up(dn__i4 a, int n) { return wasm_i32x4_shl(a, (unsigned)n); }
static DN__INLINE dn__i4 dn__i4_down(dn__i4 a, int n) { return wasm_u32x4_shr(a, (unsigned)n); }
static DN__INLINE dn__i4 dn__i4_more(dn__i4 a, dn__i4 b) { return wasm_i32x4_gt(a, b); }
static DN__INLINE dn__f4 dn__i4_float(dn__i4 a) { return wasm_f32x4_convert_i32x4(a); }
static DN__INLINE dn__i4 dn__i4_nearest(dn__f4 a) { return wasm_i32x4_trunc_sat_f32x4(wasm_f32x4_nearest(a)); }
static DN__INLINE dn__i4 dn__i4_load16(const unsigned char *p) { return wasm_u32x4_load16x4(p); }
static DN__INLINE void dn__i4_store16(unsigned char *p, dn__i4 a)
{
   wasm_v128_store64_lane(p, wasm_u16x8_narrow_i32x4(a, a), 0);
}
static DN__INLINE dn__f4 dn__f4_rounded(dn__f4 a) { return a; }
static DN__INLINE dn__i4 dn__i4_pairs(dn__i4 sum, dn__i4 x, dn__i4 w)
{
   return wasm_i32x4_add(sum, wasm_i32x4_dot_i16x8(x, w));
}
static DN__INLINE void dn__i4_widen8(const unsigned char *p, dn__i4 *low, dn__i4 *high)
{
   v128_t b = wasm_v128_load(p);
   *low = wasm_i16x8_extend_low_i8x16(b);
   *high = wasm_i16x8_extend_high_i8x16(b);
}
   #else
typedef __m128i dn__i4;
static DN__INLINE dn__i4 dn__i4_of(dn__f4 a) { return _mm_castps_si128(a); }
static DN__INLINE dn__f4 dn__i4_bits(dn__i4 a) { return _mm_castsi128_ps(a); }
static DN__INLINE dn__i4 dn__i4_load(const void *p) { return _mm_loadu_si128((const __m128i *)p); }
static DN__INLINE void dn__i4_store(void *p, dn__i4 a) { _mm_storeu_si128((__m128i *)p, a); }
static DN__INLINE dn__i4 dn__i4_all(int a) { return _mm_set1_epi32(a); }
static DN__INLINE dn__i4 dn__i4_add(dn__i4 a, dn__i4 b) { return _mm_add_epi32(a, b); }
static DN__INLINE dn__i4 dn__i4_and(dn__i4 a, dn__i4 b) { return _mm_and_si128(a, b); }
static DN__INLINE dn__i4 dn__i4_or(dn__i4 a, dn__i4 b) { return _mm_or_si128(a, b); }
static DN__INLINE dn__i4 dn__i4_up(dn__i4 a, int n) { return _mm_slli_epi32(a, n); }
static DN__INLINE dn__i4 dn__i4_down(dn__i4 a, int n) { return _mm_srli_epi32(a, n); }
static DN__INLINE dn__i4 dn__i4_more(dn__i4 a, dn__i4 b) { return _mm_cmpgt_epi32(a, b); }
static DN__INLINE dn__f4 dn__i4_float(dn__i4 a) { return _mm_cvtepi32_ps(a); }
static DN__INLINE dn__i4 dn__i4_nearest(dn__f4 a) { return _mm_cvtps_epi32(a); }
static DN__INLINE dn__i4 dn__i4_load16(const unsigned char *p)
{
   return _mm_unpacklo_epi16(_mm_loadl_epi64((const __m128i *)(const void *)p), _mm_setzero_si128());
}
static DN__INLINE void dn__i4_store16(unsigned char *p, dn__i4 a)
{
   a = _mm_srai_epi32(_mm_slli_epi32(a, 16), 16); /* so that packing with signs keeps the bits */
   _mm_storel_epi64((__m128i *)(void *)p, _mm_packs_epi32(a, a));
}
static DN__INLINE dn__f4 dn__f4_rounded(dn__f4 a)
{
   DN__ROUNDED(a, "x");
   return a;
}
static DN__INLINE dn__i4 dn__i4_pairs(dn__i4 sum, dn__i4 x, dn__i4 w) { return _mm_add_epi32(sum, _mm_madd_epi16(x, w)); }
static DN__INLINE void dn__i4_widen8(const unsigned char *p, dn__i4 *low, dn__i4 *high)
{
   __m128i b = _mm_loadu_si128((const __m128i *)(const void *)p);
   *low = _mm_srai_epi16(_mm_unpacklo_epi8(b, b), 8);
   *high = _mm_srai_epi16(_mm_unpackhi_epi8(b, b), 8);
}
   #endif
static DN__INLINE dn__i4 dn__i4_pick(dn__i4 mask, dn__i4 a, dn__i4 b) /* a where the mask is set */
{
   return dn__i4_or(dn__i4_and(mask, a), dn__i4_and(dn__i4_add(dn__i4_all(-1), dn__i4_and(mask, dn__i4_all(1))), b));
}
typedef dn__f4 dn__v4;
static DN__INLINE dn__v4 dn__v4_load(const float *p) { return dn__f4_load(p); }
static DN__INLINE void dn__v4_store(float *p, dn__v4 a) { dn__f4_store(p, a); }
static DN__INLINE dn__v4 dn__v4_all(float a) { return dn__f4_all(a); }
static DN__INLINE dn__v4 dn__v4_add(dn__v4 a, dn__v4 b) { return dn__f4_add(a, b); }
static DN__INLINE dn__v4 dn__v4_sub(dn__v4 a, dn__v4 b) { return dn__f4_sub(a, b); }
static DN__INLINE dn__v4 dn__v4_mul(dn__v4 a, dn__v4 b) { return dn__f4_rounded(dn__f4_mul(a, b)); }
static DN__INLINE dn__v4 dn__v4_div(dn__v4 a, dn__v4 b) { return dn__f4_div(a, b); }
static DN__INLINE dn__v4 dn__v4_max(dn__v4 a, dn__v4 b) { return dn__f4_max(a, b); }
static DN__INLINE dn__v4 dn__v4_min(dn__v4 a, dn__v4 b) { return dn__f4_min(a, b); }
static DN__INLINE dn__v4 dn__v4_power(dn__v4 m)
{
   return dn__i4_bits(dn__i4_add(dn__i4_up(dn__i4_of(m), 23), dn__i4_all(0x3f800000)));
}
static DN__INLINE dn__v4 dn__v4_ints(const int32_t *p) { return dn__i4_float(dn__i4_load(p)); }
static DN__INLINE dn__v4 dn__v4_halves(const unsigned char *p) /* 2^112 puts the exponent right, denormal or not */
{
   dn__i4 h = dn__i4_load16(p), size = dn__i4_and(h, dn__i4_all(0x7fff)), u = dn__i4_up(size, 13);
   u = dn__i4_of(dn__f4_mul(dn__i4_bits(u), dn__i4_bits(dn__i4_all(0x77800000))));
   u = dn__i4_or(u, dn__i4_and(dn__i4_more(size, dn__i4_all(0x7bff)), dn__i4_all(0x7f800000))); /* infinite, NaN */
   return dn__i4_bits(dn__i4_or(u, dn__i4_up(dn__i4_and(h, dn__i4_all(0x8000)), 16)));
}
static DN__INLINE void dn__v4_put_halves(unsigned char *p, dn__v4 a) /* dn__half_of */
{
   dn__i4 u = dn__i4_of(a), size = dn__i4_and(u, dn__i4_all(0x7fffffff)), sign, low, high;
   sign = dn__i4_and(dn__i4_down(u, 16), dn__i4_all(0x8000));
   low = dn__i4_add(dn__i4_of(dn__f4_add(dn__i4_bits(size), dn__f4_all(0.5f))), dn__i4_all(-0x3f000000));
   high = dn__i4_add(size, dn__i4_and(dn__i4_down(size, 13), dn__i4_all(1)));
   high = dn__i4_down(dn__i4_add(high, dn__i4_all((int)0xc8000fffu)), 13);
   high = dn__i4_pick(dn__i4_more(size, dn__i4_all(0x7f800000)), dn__i4_all(0x7e00), high);
   dn__i4_store16(p, dn__i4_or(sign, dn__i4_pick(dn__i4_more(dn__i4_all(0x38800000), size), low, high)));
}
static DN__INLINE void dn__v4_put_bf16(unsigned char *p, dn__v4 a)
{
   dn__i4 u = dn__i4_of(a), size = dn__i4_and(u, dn__i4_all(0x7fffffff)), odd;
   odd = dn__i4_and(dn__i4_down(u, 16), dn__i4_all(1));
   u = dn__i4_add(dn__i4_add(u, dn__i4_all(0x7fff)), odd);
   u = dn__i4_pick(dn__i4_more(size, dn__i4_all(0x7f800000)), dn__i4_all(0x7fc00000), u);
   dn__i4_store16(p, dn__i4_down(u, 16));
}
static DN__INLINE void dn__v4_put_bytes(unsigned char *p, dn__v4 a)
{
   int32_t n[4];
   dn__i4_store(n, dn__i4_nearest(a));
   p[0] = (unsigned char)n[0], p[1] = (unsigned char)n[1], p[2] = (unsigned char)n[2], p[3] = (unsigned char)n[3];
}
typedef struct dn__v4_heads { const uint32_t *h; int same; } dn__v4_heads;
static DN__INLINE dn__v4_heads dn__v4_head(const uint32_t *head, size_t features)
{
   dn__v4_heads h;
   h.h = head;
   h.same = features % 4 == 0;
   return h;
}
static DN__INLINE dn__v4 dn__v4_draw(const float *e, dn__v4_heads h) { return dn__draw_f4(e, h.h, h.same); }
#endif

#define DN__REDUCED_WEIGHTS 512 /* floats of buffer: 64 neighbours of 8 heads; larger neighbourhoods, more heads: the plain text */
#define DN__REDUCED_EXP(V, TARGET)                                                                           \
   TARGET static DN__INLINE dn__v##V dn__reduced_exp_v##V(dn__v##V x) /* dn__reduced_exp */                  \
   {                                                                                                         \
      dn__v##V t = dn__v##V##_mul(x, dn__v##V##_all(DN__LOG2E)), m, f, p;                                    \
      t = dn__v##V##_max(dn__v##V##_all(DN__EXP2_LOW), t);                                                   \
      m = dn__v##V##_add(t, dn__v##V##_all(DN__WHOLE));                                                      \
      f = dn__v##V##_sub(t, dn__v##V##_sub(m, dn__v##V##_all(DN__WHOLE)));                                   \
      p = dn__v##V##_add(dn__v##V##_mul(dn__v##V##_all(DN__EXP2_4), f), dn__v##V##_all(DN__EXP2_3));         \
      p = dn__v##V##_add(dn__v##V##_mul(p, f), dn__v##V##_all(DN__EXP2_2));                                  \
      p = dn__v##V##_add(dn__v##V##_mul(p, f), dn__v##V##_all(DN__EXP2_1));                                  \
      p = dn__v##V##_add(dn__v##V##_mul(p, f), dn__v##V##_all(1.0f));                                        \
      return dn__v##V##_mul(p, dn__v##V##_power(m));                                                         \
   }
/* V lanes of columns, H lanes of heads (4 or 8) */
#define DN__REDUCED_FLOATS(V, H, TARGET)                                                                     \
   TARGET static DN__INLINE dn__v##V dn__reduced_tanh_v##V(dn__v##V x, int shrink) /* dn__reduced_tanh */    \
   {                                                                                                         \
      dn__v##V c = dn__v##V##_min(dn__v##V##_all(DN__SHRINK_MOST), x), z, s, d;                              \
      c = dn__v##V##_max(dn__v##V##_all(-DN__SHRINK_MOST), c);                                               \
      z = dn__v##V##_mul(c, c);                                                                              \
      s = dn__v##V##_add(dn__v##V##_mul(z, dn__v##V##_all(DN__SHRINK_A1)), dn__v##V##_all(DN__SHRINK_A0));   \
      s = dn__v##V##_mul(dn__v##V##_mul(c, z), s);                                                           \
      d = dn__v##V##_add(dn__v##V##_mul(z, dn__v##V##_all(DN__SHRINK_B2)), dn__v##V##_all(DN__SHRINK_B1));   \
      d = dn__v##V##_add(dn__v##V##_mul(d, z), dn__v##V##_all(1.0f));                                        \
      s = dn__v##V##_div(s, d);                                                                              \
      return shrink ? dn__v##V##_add(s, dn__v##V##_sub(x, c)) : dn__v##V##_sub(c, s);                        \
   }                                                                                                         \
   TARGET static DN__INLINE dn__v##V dn__reduced_activate_v##V(dn__v##V x, dn_activation activation)         \
   {                                                                                                         \
      switch (activation) {                                                                                  \
      case DN_ACT_TANH: return dn__reduced_tanh_v##V(x, 0);                                                  \
      case DN_ACT_TANHSHRINK: return dn__reduced_tanh_v##V(x, 1);                                            \
      case DN_ACT_RELU: return dn__v##V##_max(dn__v##V##_all(0.0f), x);                                      \
      case DN_ACT_LEAKYRELU: return dn__v##V##_max(dn__v##V##_mul(x, dn__v##V##_all(0.2f)), x);              \
      case DN_ACT_NONE:                                                                                      \
      case DN_ACT_SOFTMAX:                                                                                   \
      default: return x;                                                                                     \
      }                                                                                                      \
   }                                                                                                         \
   /* a register's worth of cells; inverse and offset are read for 8 bits only */                            \
   TARGET static DN__INLINE void dn__put_v##V(unsigned char *p, dn__v##V x, dn__cell cell, const float *inverse, \
                                              const float *offset)                                           \
   {                                                                                                         \
      switch (cell) {                                                                                        \
      case DN__HALF:                                                                                         \
         x = dn__v##V##_min(dn__v##V##_all(65504.0f), dn__v##V##_max(dn__v##V##_all(-65504.0f), x));         \
         dn__v##V##_put_halves(p, x);                                                                        \
         break;                                                                                              \
      case DN__BF16: dn__v##V##_put_bf16(p, x); break;                                                       \
      case DN__BYTE:                                                                                         \
         x = dn__v##V##_add(dn__v##V##_mul(x, dn__v##V##_load(inverse)), dn__v##V##_load(offset));           \
         x = dn__v##V##_max(x, dn__v##V##_all(1.0f)); /* NaN: 1 */                                           \
         dn__v##V##_put_bytes(p, dn__v##V##_min(x, dn__v##V##_all(255.0f)));                                 \
         break;                                                                                              \
      case DN__FLOAT:                                                                                        \
      default: dn__v##V##_store((float *)(void *)p, x); break;                                               \
      }                                                                                                      \
   }                                                                                                         \
   TARGET static DN__INLINE void dn__put_some_v##V(unsigned char *p, dn__v##V x, dn__cell cell,              \
                                                   const float *inverse, const float *offset, size_t count)  \
   {                                                                                                         \
      float room[V];                                                                                         \
      if (count >= V) dn__put_v##V(p, x, cell, inverse, offset);                                             \
      else {                                                                                                 \
         dn__put_v##V((unsigned char *)room, x, cell, inverse, offset);                                      \
         memcpy(p, room, count * dn__cell_size(cell));                                                       \
      }                                                                                                      \
   }                                                                                                         \
   TARGET static void dn__cells_v##V(const float *x, size_t count, unsigned char *y, dn__cell cell, const float *inverse, \
                                     const float *offset)                                                    \
   {                                                                                                         \
      float last[V];                                                                                         \
      size_t c, size = dn__cell_size(cell);                                                                  \
      for (c = 0; c < count; c += V) {                                                                       \
         const float *from = x + c;                                                                          \
         if (count - c < V) {                                                                                \
            memset(last, 0, sizeof last);                                                                    \
            memcpy(last, from, (count - c) * sizeof(float));                                                 \
            from = last;                                                                                     \
         }                                                                                                   \
         dn__put_some_v##V(y + c * size, dn__v##V##_load(from), cell, inverse ? inverse + c : NULL,          \
                           offset ? offset + c : NULL, count - c);                                           \
      }                                                                                                      \
   }                                                                                                         \
   TARGET static void dn__finish_v##V(const void *sums, int whole, const float *columns, dn_activation activation, \
                                      size_t rows, unsigned char *y, size_t pitch, size_t count, dn__cell cell, \
                                      const float *inverse, const float *offset)                             \
   {                                                                                                         \
      size_t r, c, size = dn__cell_size(cell);                                                               \
      for (c = 0; c < count; c += V) {                                                                       \
         dn__v##V scale = dn__v##V##_load(columns + c), shift = dn__v##V##_load(columns + DN_PANEL + c), x;  \
         const float *i = inverse ? inverse + c : NULL, *o = offset ? offset + c : NULL;                     \
         for (r = 0; r < rows; r++) {                                                                        \
            x = whole ? dn__v##V##_ints((const int32_t *)sums + r * DN_PANEL + c)                            \
               : dn__v##V##_load((const float *)sums + r * DN_PANEL + c);                                    \
            x = dn__reduced_activate_v##V(dn__v##V##_add(dn__v##V##_mul(x, scale), shift), activation);      \
            dn__put_some_v##V(y + r * pitch + c * size, x, cell, i, o, count - c);                           \
         }                                                                                                   \
      }                                                                                                      \
   }                                                                                                         \
   TARGET static void dn__reduced_attend_v##V(const dn__reduced *b, const dn_graph *g, const unsigned char *z, \
                                              size_t z_pitch, size_t mask, unsigned char *y, size_t y_pitch, \
                                              size_t begin, size_t end)                                      \
   {                                                                                                         \
      size_t kf = b->heads * b->features, at = dn__logits_at(b), size = dn__cell_size(b->to), i, j, k, c;    \
      float room[DN__REDUCED_WEIGHTS + V + 15], *e = dn__cache_line(room), part[8]; /* e (count,8) */        \
      for (i = begin; i < end; i++, y += y_pitch) {                                                          \
         const uint32_t *next = g->next + g->first[i];                                                       \
         size_t count = (size_t)(g->first[i + 1] - g->first[i]) + 1;                                         \
         const unsigned char *own = z + (i & mask) * z_pitch;                                                \
         const float *dst = (const float *)(const void *)(own + at);                                         \
         if (b->heads > 8 || count > DN__REDUCED_WEIGHTS / 8) {                                              \
            dn__reduced_attend_ref(b, g, z, z_pitch, mask, y, y_pitch, i, i + 1);                            \
            continue;                                                                                        \
         }                                                                                                   \
         for (k = 0; k < 8; k += H) { /* idle heads: what follows in the row, never drawn from */            \
            dn__v##H d = dn__v##H##_load(dst + k), s = dn__v##H##_load(dst + b->heads + k), most = s;        \
            dn__v##H##_store(e + k, s);                                                                      \
            for (j = 1; j < count; j++) {                                                                    \
               s = dn__v##H##_load((const float *)(const void *)(z + (next[j - 1] & mask) * z_pitch + at) + b->heads + k); \
               most = dn__v##H##_max(most, s);                                                               \
               dn__v##H##_store(e + j * 8 + k, s);                                                           \
            }                                                                                                \
            most = dn__v##H##_add(d, most);                                                                  \
            most = dn__v##H##_max(dn__v##H##_mul(most, dn__v##H##_all(0.2f)), most);                         \
            for (j = 0; j < count; j++) {                                                                    \
               s = dn__v##H##_add(d, dn__v##H##_load(e + j * 8 + k));                                        \
               s = dn__v##H##_max(dn__v##H##_mul(s, dn__v##H##_all(0.2f)), s);                               \
               dn__v##H##_store(e + j * 8 + k, dn__v##H##_sub(s, most));                                     \
            }                                                                                                \
         }                                                                                                   \
         for (j = 0; j < count; j++) /* all of them at once: leaves the registers of the loop above free */  \
            for (k = 0; k < 8; k += H) dn__v##H##_store(e + j * 8 + k, dn__reduced_exp_v##H(dn__v##H##_load(e + j * 8 + k))); \
         for (k = 0; k < 8; k += H) {                                                                        \
            dn__v##H all = dn__v##H##_load(e + k);                                                           \
            for (j = 1; j < count; j++) all = dn__v##H##_add(all, dn__v##H##_load(e + j * 8 + k));           \
            dn__v##H##_store(part + k, dn__v##H##_div(dn__v##H##_all(1.0f), all));                           \
         }                                                                                                   \
         for (c = 0; c < kf; c += V) {                                                                       \
            const dn__v##V##_heads h = dn__v##V##_head(b->head + c, b->features);                            \
            dn__v##V s = dn__v##V##_mul(dn__v##V##_draw(e, h), dn__v##V##_halves(own + 2 * c));              \
            for (j = 1; j < count; j++)                                                                      \
               s = dn__v##V##_add(s, dn__v##V##_mul(dn__v##V##_draw(e + j * 8, h),                           \
                                                    dn__v##V##_halves(z + (next[j - 1] & mask) * z_pitch + 2 * c))); \
            s = dn__reduced_activate_v##V(dn__v##V##_mul(s, dn__v##V##_draw(part, h)), b->activation);       \
            dn__put_some_v##V(y + c * size, s, b->to, b->inverse ? b->inverse + c : NULL,                    \
                              b->offset ? b->offset + c : NULL, kf - c);                                     \
         }                                                                                                   \
      }                                                                                                      \
   }
#ifdef DN__HAS_AVX2
DN__REDUCED_EXP(8, DN__TARGET_AVX2)
DN__REDUCED_FLOATS(8, 8, DN__TARGET_AVX2)
#endif
#ifdef DN__HAS_AVX512
DN__REDUCED_FLOATS(16, 8, DN__TARGET_AVX512)
#endif
#ifdef DN__HAS_F4
DN__REDUCED_EXP(4, )
DN__REDUCED_FLOATS(4, 4, )
#endif

/* --- the fast sums */
#if defined(DN__HAS_F4) || defined(DN__HAS_AVX2)
static void dn__widen_bf16(const unsigned char *x, size_t pitch, size_t rows, size_t count, unsigned char *to,
                           size_t to_pitch) /* bfloat16 -> float */
{
   size_t r, c;
   for (r = 0; r < rows; r++) {
      uint32_t *f = (uint32_t *)(void *)(to + r * to_pitch);
      for (c = 0; c < count; c++) f[c] = dn__read16(x + r * pitch + 2 * c) << 16;
   }
}
#if !(defined(DN__F4_NEON) && defined(__ARM_FEATURE_DOTPROD))
static void dn__widen_bytes(const unsigned char *x, size_t pitch, size_t rows, size_t count, unsigned char *to,
                            size_t to_pitch) /* 8 bits -> 16, an even number of them */
{
   size_t r, c;
   for (r = 0; r < rows; r++) {
      uint16_t *h = (uint16_t *)(void *)(to + r * to_pitch);
      for (c = 0; c < count; c++) h[c] = x[r * pitch + c];
      if (count & 1) h[count] = 0;
   }
}
#endif
static DN__INLINE int32_t dn__word(const unsigned char *p) /* four bytes of a row, or two terms, as they lie */
{
   int32_t w;
   memcpy(&w, p, 4);
   return w;
}
/* the last, incomplete group of `count` bytes of each row, filled up with zeros */
static DN__INLINE void dn__last_group(const unsigned char *x, size_t pitch, size_t rows, size_t count, int32_t *to)
{
   size_t r;
   for (r = 0; r < rows; r++) to[r] = 0, memcpy(to + r, x + r * pitch, count);
}
#endif

#ifdef DN__HAS_AVX512
/* 14 rows x 32 columns: 28 sums, 2 weights and the broadcast x fill 31 of the 32 registers. SETUP makes a constant w0, w1
   of the weights at byte w + K, STEP is row r's multiplication. */
#define DN__ROWS_AT(r) ((r < 4 ? x0 : r < 8 ? x4 : r < 12 ? x8 : x12) + r % 4 * pitch)
#define DN__X(r) _mm512_set1_epi32(dn__word(DN__ROWS_AT(r) + 4 * K))
#define DN__TERM(k)                                                                                          \
   {                                                                                                         \
      enum { K = k };                                                                                        \
      DN__IN_MEMORY();                                                                                       \
      w0 = _mm512_loadu_si512(w + 64 * K);                                                                   \
      w1 = two ? _mm512_loadu_si512(w + w_pitch + 64 * K) : w0;                                              \
      DN__EACH14(DN__STEP)                                                                                   \
   }
#define DN__GROUPS(bytes) /* bytes of a row in all; whole groups, then the rest */                           \
   for (c = 0; c + 16 <= (bytes); c += 16, w += 256, x0 += 16, x4 += 16, x8 += 16, x12 += 16) {              \
      DN__TERM(0) DN__TERM(1) DN__TERM(2) DN__TERM(3)                                                        \
   }                                                                                                         \
   for (; c + 4 <= (bytes); c += 4, w += 64, x0 += 4, x4 += 4, x8 += 4, x12 += 4) DN__TERM(0)                \
   if (c < (bytes)) {                                                                                        \
      int32_t last[DN__REDUCED_ROWS];                                                                           \
      dn__last_group(x + c, pitch, DN__REDUCED_ROWS, (bytes) - c, last);                                        \
      x0 = (const unsigned char *)last, x4 = x0 + 16, x8 = x0 + 32, x12 = x0 + 48, pitch = 4;                \
      DN__TERM(0)                                                                                            \
   }
   #ifdef DN__HAS_VNNI
#define DN__START(r) __m512i a##r = s0, b##r = s1;
#define DN__STEP(r)                                                                                          \
   v = DN__X(r);                                                                                             \
   a##r = _mm512_dpbusd_epi32(a##r, v, w0);                                                                  \
   if (two) b##r = _mm512_dpbusd_epi32(b##r, v, w1);
#define DN__STORE(r)                                                                                         \
   _mm512_storeu_si512(to + r * DN_PANEL, a##r);                                                             \
   if (two) _mm512_storeu_si512(to + (DN__REDUCED_ROWS + r) * DN_PANEL, b##r);
DN__TARGET_VNNI static DN__INLINE void dn__tile_vnni_of(const unsigned char *x, size_t pitch, size_t in, const unsigned char *w,
                                                        size_t w_pitch, const int32_t *minus, int32_t *to, const int two)
{
   const unsigned char *x0 = x, *x4 = x + 4 * pitch, *x8 = x + 8 * pitch, *x12 = x + 12 * pitch;
   __m512i s0 = _mm512_loadu_si512(minus), s1 = two ? _mm512_loadu_si512(minus + DN_PANEL) : s0, w0, w1, v;
   size_t c;
   DN__EACH14(DN__START)
   DN__GROUPS(in)
   DN__EACH14(DN__STORE)
}
DN__TARGET_VNNI static void dn__tile_vnni(const unsigned char *x, size_t pitch, size_t in, const unsigned char *w,
                                          size_t w_pitch, const int32_t *minus, int more, size_t panels, void *sums)
{
   (void)more;
   if (panels == 2) dn__tile_vnni_of(x, pitch, in, w, w_pitch, minus, (int32_t *)sums, 1);
   else dn__tile_vnni_of(x, pitch, in, w, w_pitch, minus, (int32_t *)sums, 0);
}
#undef DN__START
#undef DN__STEP
#undef DN__STORE
#define DN__START(r) __m512 a##r = _mm512_setzero_ps(), b##r = a##r;
#define DN__STEP(r)                                                                                          \
   v = DN__X(r);                                                                                             \
   a##r = _mm512_dpbf16_ps(a##r, (__m512bh)v, (__m512bh)w0);                                                 \
   if (two) b##r = _mm512_dpbf16_ps(b##r, (__m512bh)v, (__m512bh)w1);
#define DN__STORE(r)                                                                                         \
   _mm512_storeu_ps(to + r * DN_PANEL, a##r);                                                                \
   if (two) _mm512_storeu_ps(to + (DN__REDUCED_ROWS + r) * DN_PANEL, b##r);
DN__TARGET_BF16 static DN__INLINE void dn__tile_bf16_of(const unsigned char *x, size_t pitch, size_t in, const unsigned char *w,
                                                        size_t w_pitch, float *to, const int two)
{
   const unsigned char *x0 = x, *x4 = x + 4 * pitch, *x8 = x + 8 * pitch, *x12 = x + 12 * pitch;
   __m512i w0, w1, v;
   size_t c;
   DN__EACH14(DN__START)
   DN__GROUPS(2 * in)
   DN__EACH14(DN__STORE)
}
DN__TARGET_BF16 static void dn__tile_bf16(const unsigned char *x, size_t pitch, size_t in, const unsigned char *w,
                                          size_t w_pitch, const int32_t *minus, int more, size_t panels, void *sums)
{
   (void)minus, (void)more;
   if (panels == 2) dn__tile_bf16_of(x, pitch, in, w, w_pitch, (float *)sums, 1);
   else dn__tile_bf16_of(x, pitch, in, w, w_pitch, (float *)sums, 0);
}
#undef DN__START
#undef DN__STEP
#undef DN__STORE
   #endif
#undef DN__X
#undef DN__TERM
#undef DN__GROUPS
/* the same of float rows and 16-bit weights, widened where they are loaded: 32 bytes a term */
#define DN__START(r)                                                                                         \
   __m512 a##r = more ? _mm512_loadu_ps(to + r * DN_PANEL) : _mm512_setzero_ps();                            \
   __m512 b##r = more && two ? _mm512_loadu_ps(to + (DN__REDUCED_ROWS + r) * DN_PANEL) : _mm512_setzero_ps();
#define DN__STEP(r)                                                                                          \
   v = _mm512_set1_ps(((const float *)(const void *)DN__ROWS_AT(r))[0]);                                     \
   a##r = _mm512_fmadd_ps(v, w0, a##r);                                                                      \
   if (two) b##r = _mm512_fmadd_ps(v, w1, b##r);
#define DN__STORE(r)                                                                                         \
   _mm512_storeu_ps(to + r * DN_PANEL, a##r);                                                                \
   if (two) _mm512_storeu_ps(to + (DN__REDUCED_ROWS + r) * DN_PANEL, b##r);
DN__TARGET_AVX512 static DN__INLINE __m512 dn__weights_avx512(const unsigned char *w, const int half)
{
   __m256i h = _mm256_loadu_si256((const __m256i *)(const void *)w);
   return half ? _mm512_maskz_cvtph_ps(DN__ALL, h)
      : _mm512_castsi512_ps(_mm512_maskz_slli_epi32(DN__ALL, _mm512_maskz_cvtepu16_epi32(DN__ALL, h), 16));
}
DN__TARGET_AVX512 static DN__INLINE void dn__tile_wide_avx512(const unsigned char *x, size_t pitch, size_t in,
                                                              const unsigned char *w, size_t w_pitch, int more, float *to,
                                                              const int two, const int half)
{
   const unsigned char *x0 = x, *x4 = x + 4 * pitch, *x8 = x + 8 * pitch, *x12 = x + 12 * pitch;
   __m512 w0, w1, v;
   size_t c;
   DN__EACH14(DN__START)
   for (c = 0; c < in; c++, w += 32, x0 += 4, x4 += 4, x8 += 4, x12 += 4) {
      w0 = dn__weights_avx512(w, half);
      w1 = two ? dn__weights_avx512(w + w_pitch, half) : w0;
      DN__EACH14(DN__STEP)
   }
   DN__EACH14(DN__STORE)
}
#undef DN__START
#undef DN__STEP
#undef DN__STORE
#undef DN__ROWS_AT
DN__TARGET_AVX512 static void dn__tile_half_avx512(const unsigned char *x, size_t pitch, size_t in, const unsigned char *w,
                                                   size_t w_pitch, const int32_t *minus, int more, size_t panels, void *sums)
{
   (void)minus;
   if (panels == 2) dn__tile_wide_avx512(x, pitch, in, w, w_pitch, more, (float *)sums, 1, 1);
   else dn__tile_wide_avx512(x, pitch, in, w, w_pitch, more, (float *)sums, 0, 1);
}
DN__TARGET_AVX512 static void dn__tile_bf16_avx512(const unsigned char *x, size_t pitch, size_t in, const unsigned char *w,
                                                   size_t w_pitch, const int32_t *minus, int more, size_t panels, void *sums)
{
   (void)minus;
   if (panels == 2) dn__tile_wide_avx512(x, pitch, in, w, w_pitch, more, (float *)sums, 1, 0);
   else dn__tile_wide_avx512(x, pitch, in, w, w_pitch, more, (float *)sums, 0, 0);
}
#endif

#ifdef DN__HAS_AVX2
/* 6 rows x 16 columns, as dn__tile_avx2 */
#define DN__START(r)                                                                                         \
   __m256 a##r = more ? _mm256_loadu_ps(to + r * DN_PANEL) : _mm256_setzero_ps();                            \
   __m256 b##r = more ? _mm256_loadu_ps(to + r * DN_PANEL + 8) : _mm256_setzero_ps();
#define DN__STEP(r)                                                                                          \
   v = _mm256_broadcast_ss((const float *)(const void *)((r < 3 ? x0 : x3) + r % 3 * pitch));                \
   a##r = _mm256_fmadd_ps(v, w0, a##r);                                                                      \
   b##r = _mm256_fmadd_ps(v, w1, b##r);
#define DN__STORE(r)                                                                                         \
   _mm256_storeu_ps(to + r * DN_PANEL, a##r);                                                                \
   _mm256_storeu_ps(to + r * DN_PANEL + 8, b##r);
DN__TARGET_AVX2 static DN__INLINE __m256 dn__weights_avx2(const unsigned char *w, const int half)
{
   __m128i h = _mm_loadu_si128((const __m128i *)(const void *)w);
   return half ? _mm256_cvtph_ps(h) : _mm256_castsi256_ps(_mm256_slli_epi32(_mm256_cvtepu16_epi32(h), 16));
}
DN__TARGET_AVX2 static DN__INLINE void dn__tile_wide_avx2(const unsigned char *x, size_t pitch, size_t in,
                                                          const unsigned char *w, int more, float *to, const int half)
{
   const unsigned char *x0 = x, *x3 = x + 3 * pitch;
   __m256 w0, w1, v;
   size_t c;
   DN__EACH6(DN__START)
   for (c = 0; c < in; c++, w += 32, x0 += 4, x3 += 4) {
      w0 = dn__weights_avx2(w, half);
      w1 = dn__weights_avx2(w + 16, half);
      DN__EACH6(DN__STEP)
   }
   DN__EACH6(DN__STORE)
}
#undef DN__START
#undef DN__STEP
#undef DN__STORE
DN__TARGET_AVX2 static void dn__tile_half_avx2(const unsigned char *x, size_t pitch, size_t in, const unsigned char *w,
                                               size_t w_pitch, const int32_t *minus, int more, size_t panels, void *sums)
{
   (void)w_pitch, (void)minus, (void)panels;
   dn__tile_wide_avx2(x, pitch, in, w, more, (float *)sums, 1);
}
DN__TARGET_AVX2 static void dn__tile_bf16_avx2(const unsigned char *x, size_t pitch, size_t in, const unsigned char *w,
                                               size_t w_pitch, const int32_t *minus, int more, size_t panels, void *sums)
{
   (void)w_pitch, (void)minus, (void)panels;
   dn__tile_wide_avx2(x, pitch, in, w, more, (float *)sums, 0);
}
/* pairs of terms, 16 bits each: their products and the sum of the two are exact */
#define DN__START(r)                                                                                         \
   __m256i a##r = _mm256_loadu_si256((const __m256i *)(const void *)(more ? to + r * DN_PANEL : minus));     \
   __m256i b##r = _mm256_loadu_si256((const __m256i *)(const void *)((more ? to + r * DN_PANEL : minus) + 8));
#define DN__STEP(r)                                                                                          \
   v = _mm256_set1_epi32(dn__word((r < 3 ? x0 : x3) + r % 3 * pitch));                                       \
   a##r = _mm256_add_epi32(a##r, _mm256_madd_epi16(v, w0));                                                  \
   b##r = _mm256_add_epi32(b##r, _mm256_madd_epi16(v, w1));
#define DN__STORE(r)                                                                                         \
   _mm256_storeu_si256((__m256i *)(void *)(to + r * DN_PANEL), a##r);                                        \
   _mm256_storeu_si256((__m256i *)(void *)(to + r * DN_PANEL + 8), b##r);
DN__TARGET_AVX2 static void dn__tile_bytes_avx2(const unsigned char *x, size_t pitch, size_t in, const unsigned char *w,
                                                size_t w_pitch, const int32_t *minus, int more, size_t panels, void *sums)
{
   const unsigned char *x0 = x, *x3 = x + 3 * pitch;
   int32_t *to = (int32_t *)sums;
   __m256i w0, w1, v;
   size_t c;
   (void)w_pitch, (void)panels;
   {
      DN__EACH6(DN__START)
      for (c = 0; c < in; c += 2, w += 32, x0 += 4, x3 += 4) {
         w0 = _mm256_cvtepi8_epi16(_mm_loadu_si128((const __m128i *)(const void *)w));
         w1 = _mm256_cvtepi8_epi16(_mm_loadu_si128((const __m128i *)(const void *)(w + 16)));
         DN__EACH6(DN__STEP)
      }
      DN__EACH6(DN__STORE)
   }
}
#undef DN__START
#undef DN__STEP
#undef DN__STORE
#endif

#ifdef DN__HAS_F4
/* 3 rows x 16 columns */
#define DN__START(r)                                                                                         \
   dn__f4 a##r = more ? dn__f4_load(to + r * 16) : zero, b##r = more ? dn__f4_load(to + r * 16 + 4) : zero,  \
          c##r = more ? dn__f4_load(to + r * 16 + 8) : zero, d##r = more ? dn__f4_load(to + r * 16 + 12) : zero;
#define DN__STEP(r)                                                                                          \
   v = dn__f4_all(((const float *)(const void *)(x + r * pitch))[n]);                                        \
   a##r = dn__f4_fma(v, w0, a##r);                                                                           \
   b##r = dn__f4_fma(v, w1, b##r);                                                                           \
   c##r = dn__f4_fma(v, w2, c##r);                                                                           \
   d##r = dn__f4_fma(v, w3, d##r);
#define DN__STORE(r)                                                                                         \
   dn__f4_store(to + r * 16, a##r), dn__f4_store(to + r * 16 + 4, b##r);                                     \
   dn__f4_store(to + r * 16 + 8, c##r), dn__f4_store(to + r * 16 + 12, d##r);
static DN__INLINE dn__f4 dn__weights_f4(const unsigned char *w, const int half)
{
   return half ? dn__v4_halves(w) : dn__i4_bits(dn__i4_up(dn__i4_load16(w), 16));
}
static DN__INLINE void dn__tile_wide_f4(const unsigned char *x, size_t pitch, size_t in, const unsigned char *w, int more,
                                        float *to, const int half)
{
   const dn__f4 zero = dn__f4_all(0.0f);
   dn__f4 w0, w1, w2, w3, v;
   size_t n;
   DN__EACH3(DN__START)
   for (n = 0; n < in; n++, w += 32) {
      w0 = dn__weights_f4(w, half), w1 = dn__weights_f4(w + 8, half);
      w2 = dn__weights_f4(w + 16, half), w3 = dn__weights_f4(w + 24, half);
      DN__EACH3(DN__STEP)
   }
   DN__EACH3(DN__STORE)
}
#undef DN__START
#undef DN__STEP
#undef DN__STORE
static void dn__tile_half_f4(const unsigned char *x, size_t pitch, size_t in, const unsigned char *w, size_t w_pitch,
                             const int32_t *minus, int more, size_t panels, void *sums)
{
   (void)w_pitch, (void)minus, (void)panels;
   dn__tile_wide_f4(x, pitch, in, w, more, (float *)sums, 1);
}
static void dn__tile_bf16_f4(const unsigned char *x, size_t pitch, size_t in, const unsigned char *w, size_t w_pitch,
                             const int32_t *minus, int more, size_t panels, void *sums)
{
   (void)w_pitch, (void)minus, (void)panels;
   dn__tile_wide_f4(x, pitch, in, w, more, (float *)sums, 0);
}
   #if defined(DN__F4_NEON) && defined(__ARM_FEATURE_DOTPROD)
/* cells without their offset of 128 are what the processor's dot product takes; then nothing is left to subtract */
#define DN__START(r) int32x4_t a##r = vdupq_n_s32(0), b##r = a##r, c##r = a##r, d##r = a##r;
#define DN__STEP(r)                                                                                          \
   v = veorq_s8(vreinterpretq_s8_s32(vdupq_n_s32(dn__word(x + r * pitch))), vdupq_n_s8(-128));               \
   a##r = vdotq_s32(a##r, v, w0);                                                                            \
   b##r = vdotq_s32(b##r, v, w1);                                                                            \
   c##r = vdotq_s32(c##r, v, w2);                                                                            \
   d##r = vdotq_s32(d##r, v, w3);
#define DN__STORE(r)                                                                                         \
   vst1q_s32(to + r * 16, a##r), vst1q_s32(to + r * 16 + 4, b##r);                                           \
   vst1q_s32(to + r * 16 + 8, c##r), vst1q_s32(to + r * 16 + 12, d##r);
static void dn__tile_dot(const unsigned char *x, size_t pitch, size_t in, const unsigned char *w, size_t w_pitch,
                         const int32_t *minus, int more, size_t panels, void *sums)
{
   const signed char *s = (const signed char *)w;
   int32_t *to = (int32_t *)sums, last[3];
   int8x16_t w0, w1, w2, w3, v;
   size_t n;
   (void)w_pitch, (void)minus, (void)more, (void)panels;
   {
      DN__EACH3(DN__START)
      for (n = 0; n < in; n += 4, s += 64, x += 4) {
         if (n + 4 > in) dn__last_group(x, pitch, 3, in - n, last), x = (const unsigned char *)last, pitch = 4;
         w0 = vld1q_s8(s), w1 = vld1q_s8(s + 16), w2 = vld1q_s8(s + 32), w3 = vld1q_s8(s + 48);
         DN__EACH3(DN__STEP)
      }
      DN__EACH3(DN__STORE)
   }
}
#undef DN__START
#undef DN__STEP
#undef DN__STORE
   #else
#define DN__START(r)                                                                                         \
   dn__i4 a##r = dn__i4_load(more ? to + r * 16 : minus), b##r = dn__i4_load((more ? to + r * 16 : minus) + 4),  \
          c##r = dn__i4_load((more ? to + r * 16 : minus) + 8), d##r = dn__i4_load((more ? to + r * 16 : minus) + 12);
#define DN__STEP(r)                                                                                          \
   v = dn__i4_all(dn__word(x + r * pitch + 2 * n));                                                          \
   a##r = dn__i4_pairs(a##r, v, w0);                                                                         \
   b##r = dn__i4_pairs(b##r, v, w1);                                                                         \
   c##r = dn__i4_pairs(c##r, v, w2);                                                                         \
   d##r = dn__i4_pairs(d##r, v, w3);
#define DN__STORE(r)                                                                                         \
   dn__i4_store(to + r * 16, a##r), dn__i4_store(to + r * 16 + 4, b##r);                                     \
   dn__i4_store(to + r * 16 + 8, c##r), dn__i4_store(to + r * 16 + 12, d##r);
static void dn__tile_bytes_f4(const unsigned char *x, size_t pitch, size_t in, const unsigned char *w, size_t w_pitch,
                              const int32_t *minus, int more, size_t panels, void *sums)
{
   int32_t *to = (int32_t *)sums;
   dn__i4 w0, w1, w2, w3, v;
   size_t n;
   (void)w_pitch, (void)panels;
   {
      DN__EACH3(DN__START)
      for (n = 0; n < in; n += 2, w += 32) {
         dn__i4_widen8(w, &w0, &w1), dn__i4_widen8(w + 16, &w2, &w3);
         DN__EACH3(DN__STEP)
      }
      DN__EACH3(DN__STORE)
   }
}
#undef DN__START
#undef DN__STEP
#undef DN__STORE
   #endif
#endif

/* --- the choice */
static const dn__reduced_text dn__reduced_ref[3] = { /* f16, bf16, int8 */
   { 1, 1, 1, 4, NULL, dn__tile_ref_half, dn__finish_ref, dn__cells_ref, NULL },
   { 1, 1, 1, 2, NULL, dn__tile_ref_bf16, dn__finish_ref, dn__cells_ref, dn__reduced_attend_ref },
   { 1, 1, 1, 1, NULL, dn__tile_ref_bytes, dn__finish_ref, dn__cells_ref, dn__reduced_attend_ref }
};
#ifdef DN__HAS_AVX2
static const dn__reduced_text dn__reduced_avx2[3] = {
   { 1, 6, 1, 4, NULL, dn__tile_half_avx2, dn__finish_v8, dn__cells_v8, NULL },
   { 1, 6, 1, 4, dn__widen_bf16, dn__tile_bf16_avx2, dn__finish_v8, dn__cells_v8, dn__reduced_attend_v8 },
   { 2, 6, 1, 2, dn__widen_bytes, dn__tile_bytes_avx2, dn__finish_v8, dn__cells_v8, dn__reduced_attend_v8 }
};
#endif
#ifdef DN__HAS_AVX512
static const dn__reduced_text dn__reduced_avx512[3] = {
   { 1, 14, 2, 4, NULL, dn__tile_half_avx512, dn__finish_v16, dn__cells_v16, NULL },
   { 1, 14, 2, 4, dn__widen_bf16, dn__tile_bf16_avx512, dn__finish_v16, dn__cells_v16, dn__reduced_attend_v16 },
   { 2, 6, 1, 2, dn__widen_bytes, dn__tile_bytes_avx2, dn__finish_v16, dn__cells_v16, dn__reduced_attend_v16 }
};
   #ifdef DN__HAS_VNNI
static const dn__reduced_text dn__reduced_vnni = { 4, 14, 2, 1, NULL, dn__tile_vnni, dn__finish_v16, dn__cells_v16, dn__reduced_attend_v16 };
static const dn__reduced_text dn__reduced_bf16 = { 2, 14, 2, 2, NULL, dn__tile_bf16, dn__finish_v16, dn__cells_v16, dn__reduced_attend_v16 };
   #endif
#endif
#ifdef DN__HAS_F4
static const dn__reduced_text dn__reduced_f4[3] = {
   { 1, 3, 1, 4, NULL, dn__tile_half_f4, dn__finish_v4, dn__cells_v4, NULL },
   { 1, 3, 1, 4, dn__widen_bf16, dn__tile_bf16_f4, dn__finish_v4, dn__cells_v4, dn__reduced_attend_v4 },
   #if defined(DN__F4_NEON) && defined(__ARM_FEATURE_DOTPROD)
   { 4, 3, 1, 1, NULL, dn__tile_dot, dn__finish_v4, dn__cells_v4, dn__reduced_attend_v4 }
   #else
   { 2, 3, 1, 2, dn__widen_bytes, dn__tile_bytes_f4, dn__finish_v4, dn__cells_v4, dn__reduced_attend_v4 }
   #endif
};
#endif
/* of an available kernel; it asks the processor, so once for a layer */
static const dn__reduced_text *dn__reduced_text_of(dn_precision precision, dn_kernel kernel)
{
   int which = precision == DN_PRECISION_F16 ? 0 : precision == DN_PRECISION_BF16 ? 1 : 2;
#ifdef DN__HAS_F4
   if (kernel == DN__F4_KERNEL) return &dn__reduced_f4[which];
#endif
#ifdef DN__HAS_AVX2
   if (kernel == DN_KERNEL_AVX2) return &dn__reduced_avx2[which];
#endif
#ifdef DN__HAS_AVX512
   if (kernel == DN_KERNEL_AVX512) {
   #ifdef DN__HAS_VNNI
      unsigned r[4];
      dn__cpuid(7, 0, r);
      if (which == 2 && r[2] & 1u << 11) return &dn__reduced_vnni; /* AVX512_VNNI */
      if (which == 1 && r[0] >= 1) {
         dn__cpuid(7, 1, r);
         if (r[0] & 1u << 5) return &dn__reduced_bf16; /* AVX512_BF16 */
      }
   #endif
      return &dn__reduced_avx512[which];
   }
#endif
   (void)kernel;
   return &dn__reduced_ref[which];
}

/* --- packing */
static size_t dn__half_up(double x) { return (size_t)(x + 0.5); }
static signed char dn__weight_byte(double x) /* |x| <= 127 or so; to the nearest, ties to even; NaN gives 0 */
{
   double size = x < 0 ? -x : x;
   size_t n;
   if (!(size <= 127.0)) size = size > 127.0 ? 127.0 : 0.0;
   n = dn__half_up(size);
   if ((double)n - size == 0.5) n &= ~(size_t)1;
   return (signed char)(x < 0 ? -(int)n : (int)n);
}
/* In memory a block's or a layer's arrays lie one after another. in, heads, features, self: heads = 0 makes a linear layer of
   `self` outputs. */
static void dn__reduced_lay(dn__reduced *l, dn__arena *a)
{
   size_t z = dn__mul(l->heads, l->features), group = l->text->group;
   size_t cells = dn__mul(dn__round(l->in, group), dn__precision_size(l->precision));
   l->out = dn__add(z, l->self);
   l->z = l->precision == DN_PRECISION_F16 ? DN__FLOAT : DN__HALF;
   l->z_panels = dn__round(l->z == DN__FLOAT && l->heads ? dn__add(z, dn__mul(2, l->heads)) : z, DN_PANEL) / DN_PANEL;
   l->panels = dn__add(l->z_panels, dn__round(l->self, DN_PANEL) / DN_PANEL);
   if (l->z == DN__HALF) l->panels = dn__add(l->panels, dn__round(dn__mul(2, l->heads), DN_PANEL) / DN_PANEL);
   l->weights = (const unsigned char *)dn__take(a, dn__mul(dn__mul(l->panels, DN_PANEL), cells), 1);
   l->columns = (const float *)dn__take(a, dn__mul(l->panels, 2 * DN_PANEL), sizeof(float));
   l->minus = l->precision == DN_PRECISION_INT8 ? (const int32_t *)dn__take(a, dn__mul(l->panels, DN_PANEL), sizeof(int32_t)) : NULL;
   l->head = (const uint32_t *)dn__take(a, dn__mul(l->z_panels, DN_PANEL), sizeof(uint32_t));
}
static void dn__reduced_make(dn__reduced *l, dn_precision precision, dn_kernel kernel, size_t in, size_t heads, size_t features,
                             size_t self, dn_activation activation)
{
   memset(l, 0, sizeof *l);
   l->precision = precision;
   l->text = dn__reduced_text_of(precision, kernel);
   l->in = in;
   l->heads = heads;
   l->features = features;
   l->self = self;
   l->activation = activation;
   l->from = l->to = dn__precision_cell(precision);
}
/* one column: its weights row (in), by which NAME is multiplied; what is added to their sum; its channel of the batch norm */
static void dn__reduced_column(const dn__reduced *l, size_t column, const double *row, double bias, const dn_batchnorm *bn,
                               size_t channel, const dn__span *spans)
{
   size_t panel = column / DN_PANEL, at = column % DN_PANEL, group = l->text->group, cell = dn__precision_size(l->precision), c, s, k;
   unsigned char *w = (unsigned char *)l->weights + panel * DN_PANEL * dn__round(l->in, group) * cell;
   float *n = (float *)l->columns + panel * 2 * DN_PANEL + at;
   double scale, shift, unit = 1;
   dn__fold(bn, channel, &scale, &shift);
   if (l->precision == DN_PRECISION_INT8) {
      double most = 0;
      int32_t sum = 0;
      for (s = c = 0; c < l->in; s++)
         for (k = 0; k < spans[s].width; k++, c++) {
            double x = row[c] * (double)spans[s].step[k];
            bias += row[c] * (double)spans[s].middle[k];
            most = most > DN_FABS(x) ? most : DN_FABS(x);
         }
      unit = most / 127.0;
      for (s = c = 0; c < l->in; s++)
         for (k = 0; k < spans[s].width; k++, c++) {
            signed char q = unit > 0 ? dn__weight_byte(row[c] * (double)spans[s].step[k] / unit) : 0;
            w[dn__reduced_at(group, at, c)] = (unsigned char)q;
            sum += q;
         }
      ((int32_t *)l->minus)[column] = -128 * sum;
   } else {
      for (c = 0; c < l->in; c++) {
         float x = dn__narrow(row[c]);
         uint16_t h = (uint16_t)(l->precision == DN_PRECISION_F16 ? dn__half_of(x) : dn__bf16_of(x));
         memcpy(w + 2 * dn__reduced_at(group, at, c), &h, 2);
      }
   }
   n[0] = dn__narrow(scale * unit);
   n[DN_PANEL] = dn__narrow(bias * scale + shift);
}
/* Laid out in memory, filled here. lin (K*F,in), att_dst, att_src (K,F) of a block; self (self,in), of a linear layer its
   weight; bias (out) or NULL; spans of the row read, 8 bits only; row: room for `in` doubles */
static void dn__reduced_fill(dn__reduced *l, const float *lin, const float *att_dst, const float *att_src, const float *self,
                             const float *bias, const dn_batchnorm *bn, const dn__span *spans, double *row)
{
   size_t kf = l->heads * l->features, own = l->panels * DN_PANEL - dn__round(l->self, DN_PANEL), o, c, f, k;
   size_t logits = l->z == DN__FLOAT ? kf : l->z_panels * DN_PANEL;
   memset((unsigned char *)l->weights, 0, l->panels * DN_PANEL * dn__round(l->in, l->text->group) * dn__precision_size(l->precision));
   memset((float *)l->columns, 0, l->panels * 2 * DN_PANEL * sizeof(float));
   if (l->minus) memset((int32_t *)l->minus, 0, l->panels * DN_PANEL * sizeof(int32_t));
   memset((uint32_t *)l->head, 0, l->z_panels * DN_PANEL * sizeof(uint32_t));
   for (o = 0; o < kf + l->self; o++) {
      const float *from = o < kf ? lin + o * l->in : self + (o - kf) * l->in;
      for (c = 0; c < l->in; c++) row[c] = (double)from[c];
      dn__reduced_column(l, o < kf ? o : own + (o - kf), row, bias ? (double)bias[o] : 0.0, bn, o, spans);
      if (o < kf) ((uint32_t *)l->head)[o] = (uint32_t)(o / l->features);
   }
   for (k = 0; k < 2 * l->heads; k++) { /* W_k^T dst_k, then W_k^T src_k, as in dn_gat_pack */
      const float *att = k < l->heads ? att_dst + k * l->features : att_src + (k - l->heads) * l->features;
      const float *from = lin + k % l->heads * l->features * l->in;
      for (c = 0; c < l->in; c++)
         for (row[c] = 0, f = 0; f < l->features; f++) row[c] += (double)att[f] * (double)from[f * l->in + c];
      dn__reduced_column(l, logits + k, row, 0.0, NULL, 0, spans);
   }
}

/* --- running. z of a block: rows of z_pitch bytes; y: the columns after z's in the same rows, pointwise; all rows from 0 */
static size_t dn__reduced_z_pitch(const dn__reduced *l)
{
   size_t own = dn__round(l->self, DN_PANEL) / DN_PANEL;
   return dn__round(l->z_panels * DN_PANEL * dn__cell_size(l->z) + (l->panels - l->z_panels - own) * DN_PANEL * 4, DN__ALIGN);
}
/* sums (panels, rows of the text, 16) of rows x and panels p .. */
static void dn__reduced_sums(const dn__reduced *l, const unsigned char *x, size_t pitch, size_t p, size_t panels, float *sums)
{
   const dn__reduced_text *t = l->text;
   size_t w_pitch = DN_PANEL * dn__round(l->in, t->group) * dn__precision_size(l->precision), c, count;
   const unsigned char *w = l->weights + p * w_pitch;
   const int32_t *minus = l->minus ? l->minus + p * DN_PANEL : NULL;
   float room[DN__REDUCED_ROWS * DN__WIDENED];
   if (!t->widen) {
      t->tile(x, pitch, l->in, w, w_pitch, minus, 0, panels, sums);
      return;
   }
   for (c = 0; c < l->in; c += count) {
      size_t size = dn__cell_size(l->from);
      count = dn__min(DN__WIDENED, l->in - c);
      t->widen(x + c * size, pitch, t->rows, count, (unsigned char *)room, DN__WIDENED * t->cell);
      t->tile((const unsigned char *)room, DN__WIDENED * t->cell, count, w + DN_PANEL * c * dn__precision_size(l->precision), w_pitch,
              minus, c != 0, panels, sums);
   }
}
/* A last tile that would stick out is moved back over rows already done, whose bits it repeats; fewer rows than a tile go
   one by one, each as a tile of that row alone. */
static void dn__reduced_products(const dn__reduced *l, const unsigned char *x, size_t x_pitch, unsigned char *z, size_t z_pitch,
                                 unsigned char *y, size_t y_pitch, size_t rows)
{
   const dn__reduced_text *t = l->text;
   float sums[2 * DN__REDUCED_ROWS * DN_PANEL];
   size_t own = l->panels - dn__round(l->self, DN_PANEL) / DN_PANEL, kf = l->heads * l->features, r, n, p, q, count;
   for (r = 0; r < rows; r += n) {
      n = rows >= t->rows ? t->rows : 1;
      r = dn__min(r, rows - n);
      for (p = 0; p < l->panels; p += count) {
         count = dn__min(t->panels, l->panels - p);
         dn__reduced_sums(l, x + r * x_pitch, n == t->rows ? x_pitch : 0, p, count, sums);
         for (q = p; q < p + count; q++) {
            const float *from = sums + (q - p) * t->rows * DN_PANEL, *columns = l->columns + q * 2 * DN_PANEL;
            int whole = l->precision == DN_PRECISION_INT8;
            if (q < own) { /* z, then logits */
               dn__cell cell = q < l->z_panels ? l->z : DN__FLOAT;
               size_t at = dn__min(q, l->z_panels) * DN_PANEL * dn__cell_size(l->z) + (q - dn__min(q, l->z_panels)) * DN_PANEL * 4;
               t->finish(from, whole, columns, DN_ACT_NONE, n, z + r * z_pitch + at, z_pitch, DN_PANEL, cell, NULL, NULL);
            } else {
               size_t o = kf + (q - own) * DN_PANEL;
               t->finish(from, whole, columns, l->activation, n, y + r * y_pitch + o * dn__cell_size(l->to), y_pitch,
                         dn__min(DN_PANEL, l->out - o), l->to, l->inverse ? l->inverse + o : NULL, l->offset ? l->offset + o : NULL);
            }
         }
      }
   }
}
/* nodes begin to end - 1; y starts with node begin. Float z of f16: by >>attention's text, y float */
static void dn__reduced_attend(const dn__reduced *l, dn_kernel kernel, const dn_graph *g, const unsigned char *z, size_t z_pitch,
                               size_t mask, unsigned char *y, size_t y_pitch, size_t begin, size_t end)
{
   if (l->z == DN__FLOAT) {
      const dn__kernel *k = dn__kernel_of(kernel);
      dn_gat b;
      memset(&b, 0, sizeof b);
      b.heads = l->heads;
      b.features = l->features;
      b.self = l->self;
      b.activation = l->activation;
      b.head = l->head;
      (k ? k->attend : dn__attend_ref)(&b, g, (const float *)(const void *)z, mask, (float *)(void *)y, y_pitch / sizeof(float),
                                       begin, end);
   } else l->text->attend(l, g, z, z_pitch, mask, y, y_pitch, begin, end);
}
/* a row of cells as floats, for probes */
static void dn__floats_of_cells(const unsigned char *x, size_t width, dn__cell cell, const dn__span *span, float *y)
{
   size_t c;
   for (c = 0; c < width; c++) {
      float v = dn__read_cell(x + c * dn__cell_size(cell), cell);
      y[c] = cell == DN__BYTE ? span->middle[c] + span->step[c] * (v - 128.0f) : v;
   }
}

/* ===================================================================================== >>pooling
   in       rows v (N,d), graph (CSR)      out  clusters: pairs, scores, the coarse graph
   touches  the clusters' arrays and the scratch passed in
   paper    T 3.10-3.12; after Diehl, Edge Contraction Pooling for Graph Neural Networks, 2019
   read     dn_pool_scores_ref, dn_pool_contract_ref, dn_pool_gather_ref, dn_pool_scatter_ref first; the others do the
            same, over ranges of a job, the contraction in linear time */
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
DN_API void dn_pool_scores_ref(const dn_pool *pool, const dn_graph *g, const float *v, size_t v_stride, float *scores)
{
   size_t i, e, c;
   for (i = 0; i < g->nodes; i++) {
      size_t from = g->first[i], to = g->first[i + 1];
      for (e = from; e < to; e++) { /* leaky(dst . z_i + src . z_j), z = W v */
         const float *vi = v + i * v_stride, *vj = v + g->next[e] * v_stride;
         double sum = 0;
         for (c = 0; c < pool->in; c++)
            sum += (double)pool->dst[c] * (double)vi[c] + (double)pool->src[c] * (double)vj[c];
         scores[e] = dn__leaky(dn__narrow(sum));
      }
      if (from < to) dn__softmax(scores + from, to - from); /* over N(i), i itself left out: T 3.10 */
   }
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
   size_t v_stride, y_stride, width, first; /* y starts with row `first` */
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

/* sum of exp(x - most); room for whole registers behind the last x */
static float dn__exp_sum(float *x, size_t count, float most)
{
   float sum = 0;
   size_t k;
#ifdef DN__HAS_F4
   float part[4];
   dn__f4 all = dn__f4_all(0.0f);
   for (k = count; k % 4; k++) x[k] = most - 200.0f; /* exp is 1e-38 there */
   for (k = 0; k < count; k += 4) all = dn__f4_add(all, dn__exp_f4(dn__f4_sub(dn__f4_load(x + k), dn__f4_all(most))));
   dn__f4_store(part, all);
   sum = (part[0] + part[2]) + (part[1] + part[3]);
#else
   for (k = 0; k < count; k++) sum += dn__exp(x[k] - most);
#endif
   return sum;
}
static void dn__pool_rescore_range(void *job, size_t begin, size_t end, unsigned worker)
{
   enum { FEW = 32 }; /* neighbours at a time: whole registers */
   const dn__pool_job *p = (const dn__pool_job *)job;
   size_t m, e, k;
   (void)worker;
   for (m = begin; m < end; m++) {
      size_t i = p->c->members[2 * m], j = p->c->members[2 * m + 1], last = p->g->first[i + 1];
      float dst, own = 0, most = 0, sum = 0, x[FEW];
      if (i == j) continue;
      dst = dn__dot(p->pool->dst, p->v + i * p->v_stride, p->pool->in);
      for (e = p->g->first[i]; e < last; e += FEW) {
         size_t count = dn__min(FEW, last - e);
         float before = most;
         for (k = 0; k < count; k++) {
            x[k] = dn__leaky(dst + dn__dot(p->pool->src, p->v + p->g->next[e + k] * p->v_stride, p->pool->in));
            if ((e == p->g->first[i] && k == 0) || x[k] > most) most = x[k];
            if (p->g->next[e + k] == j) own = x[k];
         }
         sum = (e == p->g->first[i] ? 0 : sum * dn__exp(before - most)) + dn__exp_sum(x, count, most); /* summed under a smaller maximum */
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
DN_API void dn_pool_gather_ref(const dn_pool *pool, const dn_clusters *c, const float *v, size_t v_stride, size_t width,
                               float *coarse, size_t coarse_stride)
{
   size_t m, x;
   for (m = 0; m < c->count; m++) {
      size_t i = c->members[2 * m], j = c->members[2 * m + 1];
      for (x = 0; x < width; x++) {
         float vi = v[i * v_stride + x], vj = v[j * v_stride + x];
         coarse[m * coarse_stride + x] = i == j ? vi : dn__pool_factor(pool, c, m) * (vi + vj); /* T 3.11 */
      }
   }
}
DN_API void dn_pool_scatter_ref(const dn_pool *pool, const dn_clusters *c, const float *coarse, size_t coarse_stride,
                                size_t width, size_t nodes, float *v, size_t v_stride)
{
   size_t i, x;
   for (i = 0; i < nodes; i++) {
      size_t m = c->cluster[i];
      float s = c->members[2 * m] == c->members[2 * m + 1] ? 1.0f : dn__pool_factor(pool, c, m);
      for (x = 0; x < width; x++) v[i * v_stride + x] = coarse[m * coarse_stride + x] / s; /* T 3.12 */
   }
}
/* to = s (a + b), or s a when b is NULL */
static void dn__pool_row(float *to, const float *a, const float *b, float s, size_t width)
{
   size_t x = 0;
#ifdef DN__HAS_F4
   dn__f4 all = dn__f4_all(s);
   for (; x + 4 <= width; x += 4) {
      dn__f4 v = dn__f4_load(a + x);
      dn__f4_store(to + x, dn__f4_mul(b ? dn__f4_add(v, dn__f4_load(b + x)) : v, all));
   }
#endif
   for (; x < width; x++) to[x] = (b ? a[x] + b[x] : a[x]) * s;
}
static void dn__pool_gather_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__pool_job *p = (const dn__pool_job *)job;
   size_t m;
   (void)worker;
   for (m = begin; m < end; m++) {
      size_t i = p->c->members[2 * m], j = p->c->members[2 * m + 1];
      const float *a = p->v + i * p->v_stride, *b = p->v + j * p->v_stride;
      float *to = p->y + (m - p->first) * p->y_stride;
      if (i == j) memcpy(to, a, p->width * sizeof *to);
      else dn__pool_row(to, a, b, dn__pool_factor(p->pool, p->c, m), p->width); /* T 3.11 */
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
   size_t i;
   (void)worker;
   for (i = begin; i < end; i++) {
      size_t m = p->c->cluster[i];
      const float *from = p->v + m * p->v_stride;
      float *to = p->y + (i - p->first) * p->y_stride;
      int alone = p->c->members[2 * m] == p->c->members[2 * m + 1];
      float s = alone ? 1.0f : 1.0f / dn__pool_factor(p->pool, p->c, m);
      dn__pool_row(to, from, NULL, s, p->width); /* T 3.12 */
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
            garments' networks are in >>garmentnets
   touches  the memory handed in; a loaded model is never written again
   paper    DenseGATs T 3.2, MultiResGNet T 3.3, baselines T tables 3.3 and 3.4; spec section 5
   read     dn__build_model (what each architecture is made of), then dn__wave_run and dn__run_densegats (how it runs) */

enum { DN__MAX_FEATURES = 16, DN__MAX_CHAIN = 64, DN__MAX_SPANS = 16, DN__NAME = 64, DN__TILE = 128 };
typedef enum dn__kind { DN__LINEAR, DN__GAT_BLOCK } dn__kind;

typedef struct dn__block { /* one named layer */
   char name[DN__NAME];
   dn__kind kind;
   size_t in, out;
   dn_linear linear;
   dn_gat gat;
   dn__reduced reduced; /* of a block at reduced precision, whose linear or gat is then empty but for the kernel; text NULL: float32 */
   dn__span span;       /* int8: what the cells made of its output stand for; width 0: it is read as floats */
} dn__block;

struct dn__blend_net;
typedef struct dn__stage { /* what goes into a network and comes out; clothnet is two */
   dn_feature features[DN__MAX_FEATURES];
   size_t feature_count, row_width;
   size_t bound_width;                     /* columns of the row that no pose changes, kept out of the frame: dn_model.bound */
   size_t fit;                             /* n of fit:n */
   const float *input_mean;                /* (D), in the order of dn__place; NULL when absent */
   const float *input_scale, *input_rest;  /* (D) 1 / std as two floats */
   float output_mean[3], output_std[3];
} dn__stage;
typedef struct dn__branch { /* blocks around a pool, and the layers after them */
   size_t first;            /* its first block */
   size_t locals;           /* blocks of its dense module, which come first; clothnet has none */
   dn_pool pool;
   char pool_name[DN__NAME], unpool_name[DN__NAME];
   dn__span pooled, unpooled; /* int8: as a block's span */
} dn__branch;

struct dn_model {
   dn_model_info info;
   dn__stage stage[2];            /* the second one: clothnet's detail */
   const dn_allocator *allocator; /* points at the copy below, or NULL: DN_MALLOC */
   dn_allocator allocator_copy;
   int owned;                     /* made by dn_model_load: dn_model_free gives the memory back */
   size_t block_count;
   dn__block *blocks;             /* in run order */
   dn_linear bound;               /* what the bound columns add to the first block: bn(W x + b), out of its packing */
   size_t chain[3];               /* baselines: how many pre, gat and post blocks */
   struct dn__blend_net *blend;   /* neuralblendshapes */
   dn__branch branch[2];          /* multiresgnet: one; garfitnet, clothnet's detail: direction and length */
};

/* --- loading. The builder runs twice over the same code: first measuring (arena without memory), then packing. */
typedef struct dn__loader {
   const dn_tensors *file;
   dn_error *err;
   dn_precision precision;
   dn_kernel kernel;
   int float_rows;         /* the next block reads floats, so is packed as float32 unless precision is of weights alone */
   int float_output;       /* its output is read as floats */
   dn__span spans[DN__MAX_SPANS]; /* int8: of the row that the next block reads, from its first column on */
   size_t span_count;
   dn__span made;          /* of the block added last */
   dn_result failed;       /* first failure; everything after it does nothing */
   dn__arena memory;       /* the model's */
   dn__arena temp;         /* floats of one layer; reset for each */
   size_t temp_peak;
   dn_model *model;
   int packing;
} dn__loader;

static void dn__build_blend(dn__loader *l); /* neuralblendshapes: >>blend */

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
static void dn__join3(char *buffer, size_t size, const char *a, const char *b, const char *c)
{
   dn__text t = dn__text_of(buffer, size);
   dn__put(&t, a);
   dn__put(&t, b);
   dn__put(&t, c);
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
      dn__load_fail(l, DN_BAD_TYPE, name, t->format == DN_ST_I32 ? ": expected F32, F16 or BF16, file has I32"
                    : ": expected F32, F16 or BF16, file has another type");
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
/* --- rows. The first layer is linear in its row, so that what the pose-independent columns add to it is known when a
   character is bound (dn__bind_start): a frame's rows hold the live columns only. */
static int dn__per_joint(dn_feature f) { return f == DN_GEODESIC || f == DN_DISTANCE; }
/* how many joints the per-joint features of such a row have, 0 when there are none or the features do not make it up */
static size_t dn__row_joints(const dn__stage *s, size_t row_width, size_t *narrow, size_t *wide)
{
   size_t i;
   *narrow = *wide = 0;
   for (i = 0; i < s->feature_count; i++) {
      if (dn__per_joint(s->features[i])) ++*wide;
      else *narrow += s->features[i] == DN_FIT ? s->fit : 3;
   }
   return *wide && row_width > *narrow && (row_width - *narrow) % *wide == 0 ? (row_width - *narrow) / *wide : 0;
}
static size_t dn__live_width(const dn__stage *s) { return s->row_width - s->bound_width; }
/* where a column of the row stands once the live columns come first, then the bound ones */
static size_t dn__place(const dn__stage *s, size_t column)
{
   size_t narrow, wide, k, live = 0, bound = dn__live_width(s);
   size_t joints = dn__row_joints(s, s->row_width, &narrow, &wide);
   if (!s->bound_width) return column;
   for (k = 0; k < s->feature_count; k++) {
      size_t width = dn__per_joint(s->features[k]) ? joints : s->features[k] == DN_FIT ? s->fit : 3;
      size_t *at = s->features[k] == DN_GEODESIC ? &bound : &live;
      if (column < width) return *at + column;
      column -= width;
      *at += width;
   }
   return column;
}
/* Is the block about to be added the first one, on rows of `width` with bound and live columns? A row of nothing but
   geodesic distances stays as it is. */
static int dn__splits(dn__loader *l, size_t width)
{
   dn__stage *s = &l->model->stage[0];
   size_t narrow, wide, k, joints = dn__row_joints(s, width, &narrow, &wide), bound = 0;
   if (l->model->block_count != 1) return 0; /* counted already */
   for (k = 0; k < s->feature_count; k++) bound += s->features[k] == DN_GEODESIC ? joints : 0;
   if (bound == 0 || bound == width) return 0;
   s->row_width = width;
   s->bound_width = bound;
   return 1;
}
/* the first layer: y = act(bn(W_live x_live) + start), start = bn(W_bound x_bound + b); bn's shift goes with start */
static void dn__pack_first(dn__loader *l, dn__block *b, const float *weight, const float *bias, const dn_batchnorm *bn,
                           dn_activation act)
{
   const dn__stage *s = &l->model->stage[0];
   size_t live = dn__live_width(s), o, c, all = dn__mul(b->out, s->row_width);
   float *part = (float *)dn__take(&l->temp, all, sizeof(float)); /* (out,live), then (out,bound) */
   float *zeros = (float *)dn__take(&l->temp, b->out, sizeof(float));
   void *memory = dn__take(&l->memory, dn_linear_size(live, b->out), 1);
   void *bound_memory = dn__take(&l->memory, dn_linear_size(s->bound_width, b->out), 1);
   dn_batchnorm scale;
   l->temp_peak = dn__max(l->temp_peak, l->temp.used);
   b->in = live;
   if (!l->packing || l->failed) return;
   for (c = 0; c < s->row_width; c++) {
      size_t place = dn__place(s, c);
      float *to = place < live ? part + place : part + b->out * live + (place - live);
      for (o = 0; o < b->out; o++) to[o * (place < live ? live : s->bound_width)] = weight[o * s->row_width + c];
   }
   memset(zeros, 0, b->out * sizeof *zeros);
   if (bn) scale = *bn, scale.bias = scale.mean = zeros;
   dn_linear_pack(&b->linear, live, b->out, part, NULL, bn ? &scale : NULL, act, memory);
   b->linear.kernel = l->kernel;
   dn_linear_pack(&l->model->bound, s->bound_width, b->out, part + b->out * live, bias, bn, DN_ACT_NONE, bound_memory);
}
/* name.range [2, width], the least and the most of each column, as what 8-bit cells of such rows stand for (>>reduced). Only
   int8 needs ranges. */
static dn__span dn__span_of(dn__loader *l, const char *name, size_t width)
{
   dn__span span;
   char full[DN__NAME + 24], text[120];
   const float *range;
   float *middle, *step, *inverse, *offset;
   size_t c;
   memset(&span, 0, sizeof span);
   if (l->failed || l->precision != DN_PRECISION_INT8) return span;
   dn__join(full, sizeof full, name, ".range");
   if (!dn_tensors_find(l->file, full)) {
      dn__load_fail(l, DN_MISSING_TENSOR, full, ": not in the file; int8 needs it, examples/calibrate measures it");
      return span;
   }
   range = dn__floats(l, dn__want(l, full, 2, 2, width));
   span.width = width;
   span.middle = middle = (float *)dn__take(&l->memory, width, sizeof(float));
   span.step = step = (float *)dn__take(&l->memory, width, sizeof(float));
   span.inverse = inverse = (float *)dn__take(&l->memory, dn__add(width, 2 * DN_PANEL), sizeof(float));
   span.offset = offset = (float *)dn__take(&l->memory, dn__add(width, 2 * DN_PANEL), sizeof(float));
   if (!l->packing || l->failed) return span;
   memset(inverse, 0, (width + 2 * DN_PANEL) * sizeof(float)); /* whole registers are read past the end */
   memset(offset, 0, (width + 2 * DN_PANEL) * sizeof(float));
   for (c = 0; c < width; c++) {
      double least = (double)range[c], most = (double)range[width + c];
      middle[c] = dn__narrow((most + least) / 2);
      step[c] = dn__narrow((most - least) / 254);
      inverse[c] = step[c] > 0.0f ? dn__narrow(1.0 / (double)step[c]) : 0.0f;
      offset[c] = dn__narrow(128.0 - (double)middle[c] * (double)inverse[c]);
      if (!(least < most) || !(step[c] > 1e-30f) || DN_FABSF(offset[c]) > 1e7f) {
         dn__number(text, sizeof text, ": channel ", c, ": expected the least value below the most, by more than rounding");
         dn__load_fail(l, DN_BAD_VALUE, full, text);
         break;
      }
   }
   return span;
}
/* the next block reads: what the last one made alone; or that in front of what the last one read (T 3.6) */
static void dn__spans_reset(dn__loader *l, dn__span span)
{
   l->spans[0] = span;
   l->span_count = 1;
}
static void dn__spans_join(dn__loader *l, dn__span span)
{
   DN_ASSERT(l->span_count < DN__MAX_SPANS);
   memmove(l->spans + 1, l->spans, l->span_count * sizeof *l->spans);
   l->spans[0] = span;
   l->span_count++;
}
/* Packs a block at the loader's precision, if that is a reduced one and the block does not read floats; 0: it is the caller's
   to pack as float32. Arguments as dn__reduced_fill's; NULL while measuring. */
static int dn__pack_reduced(dn__loader *l, dn__block *b, size_t heads, size_t features, size_t self, dn_activation act,
                            const float *lin, const float *dst, const float *src, const float *own, const float *bias,
                            const dn_batchnorm *bn)
{
   dn__reduced *r = &b->reduced;
   double *row;
   int reduces = l->precision != DN_PRECISION_F32 && !l->float_rows;
   if (!l->float_output) b->span = l->made = dn__span_of(l, b->name, b->out);
   if (!reduces) return 0;
   dn__reduced_make(r, l->precision, l->kernel, b->in, heads, features, self, act);
   dn__reduced_lay(r, &l->memory);
   row = (double *)dn__take(&l->temp, b->in, sizeof *row);
   l->temp_peak = dn__max(l->temp_peak, l->temp.used);
   if (l->float_output) r->to = DN__FLOAT;
   r->inverse = b->span.inverse;
   r->offset = b->span.offset;
   if (l->packing && !l->failed) {
      dn__reduced_fill(r, lin, dst, src, own, bias, bn, l->spans, row);
      b->gat.heads = heads; /* what the rest of the library asks a block */
      b->gat.features = features;
      b->gat.self = self;
      b->gat.in = b->linear.in = b->in;
      b->linear.out = b->out;
      b->gat.kernel = b->linear.kernel = l->kernel;
      b->gat.activation = b->linear.activation = act;
   }
   return 1;
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
   if (dn__splits(l, b->in)) {
      dn__pack_first(l, b, weight, bias, has_bn ? &bn : NULL, act);
      return b->out;
   }
   if (dn__pack_reduced(l, b, 0, 0, b->out, act, NULL, NULL, NULL, weight, bias, has_bn ? &bn : NULL)) return b->out;
   memory = dn__take(&l->memory, dn_linear_size(b->in, b->out), 1);
   if (l->packing && !l->failed) {
      dn_linear_pack(&b->linear, b->in, b->out, weight, bias, has_bn ? &bn : NULL, act, memory);
      b->linear.kernel = l->kernel;
   }
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
   if (dn__pack_reduced(l, b, heads, features, selfs, act, f_lin, f_dst, f_src, f_self, NULL, has_bn ? &bn : NULL)) return b->out;
   memory = dn__take(&l->memory, dn_gat_size(b->in, heads, features, selfs), 1);
   if (l->packing && !l->failed) {
      dn_gat_pack(&b->gat, b->in, heads, features, selfs, f_lin, f_dst, f_src, f_self, has_bn ? &bn : NULL, act,
                  memory);
      b->gat.kernel = l->kernel;
   }
   return b->out;
}
/* The branch's pool, prefix.pool; it starts at the next block */
static void dn__add_branch(dn__loader *l, const char *prefix, size_t which, size_t first, size_t locals, size_t in)
{
   dn__branch *q = &l->model->branch[which];
   char full[DN__NAME + 24], name[DN__NAME];
   const dn_tensor *lin, *dst, *src;
   const float *f_lin, *f_dst, *f_src, *f_offset = NULL;
   void *memory;
   if (l->failed) return;
   l->temp.used = 0;
   dn__join(name, sizeof name, prefix, "pool");
   memcpy(q->pool_name, name, sizeof name);
   dn__join(q->unpool_name, sizeof q->unpool_name, prefix, "unpool");
   q->first = first;
   q->locals = locals;
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
   q->pooled = dn__span_of(l, name, in);
   memory = dn__take(&l->memory, dn_pool_size(in, lin->shape[0]), 1);
   if (l->packing && !l->failed)
      dn_pool_pack(&q->pool, in, lin->shape[0], f_lin, f_dst, f_src, f_offset ? f_offset[0] : 0.0f, memory);
}

static int dn__chain_has(const dn__loader *l, const char *stem, size_t n, dn__kind kind)
{
   char probe[DN__NAME];
   dn__number(probe, sizeof probe, stem, n, kind == DN__LINEAR ? ".weight" : ".lin.weight");
   return dn_tensors_find(l->file, probe) != NULL;
}
/* pre.N, gat.N or post.N as many as the file has, from 0 without gaps; followed: by other layers of kinds that may be reduced */
static size_t dn__add_chain(dn__loader *l, const char *stem, dn__kind kind, int followed, size_t *first_in, size_t width,
                            size_t *count)
{
   size_t n;
   int pre = dn__name_equal(stem, "pre.");
   for (n = 0; !l->failed && dn__chain_has(l, stem, n, kind); n++) {
      char name[DN__NAME];
      size_t in = width;
      int more = dn__chain_has(l, stem, n + 1, kind);
      dn__number(name, sizeof name, stem, n, "");
      if (n == DN__MAX_CHAIN) {
         dn__load_fail(l, DN_UNSUPPORTED, name, ": more than 64 layers of one kind");
         break;
      }
      l->float_rows = pre || *first_in == 0;
      l->float_output = pre ? more || !followed : !more && !followed;
      width = kind == DN__LINEAR ? dn__add_linear(l, name, &in, 0, DN_ACT_TANH)
         : dn__add_gat(l, name, &in, DN_ACT_TANH);
      dn__spans_reset(l, l->made);
      if (*first_in == 0) *first_in = in;
   }
   l->float_rows = l->float_output = 1; /* as `out` is */
   *count = n;
   return width;
}

/* A dense module of GAT blocks stem0, stem1 ... on rows of `in` (T 3.6). Returns the width of its output, all rows and x. */
static size_t dn__add_dense(dn__loader *l, const char *stem, size_t count, size_t *in, dn_activation act)
{
   size_t b, w = *in;
   for (b = 0; b < count; b++) {
      char name[DN__NAME];
      size_t f;
      dn__number(name, sizeof name, stem, b, "");
      f = dn__add_gat(l, name, &w, act); /* the next block reads f_b || x_b */
      dn__spans_join(l, l->made);
      if (b == 0) *in = w;
      w = dn__add(w, f);
   }
   return w;
}
/* blocks `from` to `to` - 1 of stem0, stem1 ..., one after the other; returns the width of the last */
static size_t dn__add_gats(dn__loader *l, const char *stem, size_t from, size_t to, size_t in, dn_activation act)
{
   size_t b;
   for (b = from; b < to; b++) {
      char name[DN__NAME];
      dn__number(name, sizeof name, stem, b, "");
      in = dn__add_gat(l, name, &in, act);
      dn__spans_reset(l, l->made);
   }
   return in;
}
/* prefix post.0, post.1 and out: the layers at the end, node by node */
static void dn__add_tail(dn__loader *l, const char *prefix, size_t in, dn_activation act, size_t out)
{
   char name[DN__NAME];
   dn__join(name, sizeof name, prefix, "post.0");
   in = dn__add_linear(l, name, &in, 0, act);
   dn__spans_reset(l, l->made);
   dn__join(name, sizeof name, prefix, "post.1");
   l->float_output = 1;
   in = dn__add_linear(l, name, &in, 0, act);
   dn__join(name, sizeof name, prefix, "out");
   l->float_rows = 1;
   dn__add_linear(l, name, &in, out, DN_ACT_NONE);
   l->float_rows = l->float_output = 0; /* another tail may follow */
}
/* pre.0 and pre.1, float32 always; what comes after them need not be */
static size_t dn__add_pre(dn__loader *l, size_t *in)
{
   size_t w;
   l->float_rows = l->float_output = 1;
   w = dn__add_linear(l, "pre.0", in, 0, DN_ACT_TANH);
   l->float_output = 0;
   w = dn__add_linear(l, "pre.1", &w, 0, DN_ACT_TANH);
   l->float_rows = 0;
   dn__spans_reset(l, l->made);
   return w;
}
/* Local and global side by side (T 3.3, 3.13): `locals` blocks as a dense module; pool, global.0, global.1, unpool,
   global.2. Returns the width of both. */
static size_t dn__add_local_global(dn__loader *l, const char *prefix, size_t which, size_t locals, size_t in,
                                   dn_activation act)
{
   char stem[DN__NAME];
   size_t first = l->model->block_count, local, global, count, k;
   dn__span spans[DN__MAX_SPANS];
   dn__join(stem, sizeof stem, prefix, "local.");
   local = dn__add_dense(l, stem, locals, &in, act);
   dn__add_branch(l, prefix, which, first, locals, in);
   memcpy(spans, l->spans, sizeof spans);
   count = l->span_count;
   dn__join(stem, sizeof stem, prefix, "global.");
   dn__spans_reset(l, l->model->branch[which].pooled);
   global = dn__add_gats(l, stem, 0, 1, in, act);
   l->float_output = 1; /* unpooled as floats */
   global = dn__add_gats(l, stem, 1, 2, global, act);
   l->float_output = 0;
   l->model->branch[which].unpooled = dn__span_of(l, l->model->branch[which].unpool_name, global);
   dn__spans_reset(l, l->model->branch[which].unpooled);
   global = dn__add_gats(l, stem, 2, 3, global, act);
   for (k = count; k > 0; k--) dn__spans_join(l, spans[k - 1]); /* local || global */
   return dn__add(local, global);
}
static void dn__build_garment(dn__loader *l, dn_arch arch); /* >>garmentnets */

/* What each architecture is made of, in run order. Widths come from the tensors, structure from here (spec
   section 5). */
static void dn__build_model(dn__loader *l, dn_arch arch)
{
   size_t in = 0, w, out_in, k;
   char name[DN__NAME];
   dn_model *m = l->model;
   if (arch == DN_GARFIT_COARSE || arch == DN_GARFITNET || arch == DN_CLOTHNET) {
      dn__build_garment(l, arch);
      return;
   }
   if (arch == DN_DENSEGATS) { /* T 3.2 */
      w = dn__add_pre(l, &in);
      for (k = 0; k < 3; k++) {
         dn__number(name, sizeof name, "dense.", k, ".");
         w = dn__add_dense(l, name, 6, &w, DN_ACT_TANHSHRINK);
         if (k == 2) break;
         dn__number(name, sizeof name, "transition.", k, "");
         w = dn__add_gat(l, name, &w, DN_ACT_TANHSHRINK);
         dn__spans_reset(l, l->made);
      }
      dn__add_tail(l, "", w, DN_ACT_TANH, 3);
   } else if (arch == DN_MULTIRESGNET) {
      w = dn__add_pre(l, &in);
      w = dn__add_local_global(l, "", 0, 2, w, DN_ACT_TANHSHRINK);
      dn__add_tail(l, "", w, DN_ACT_TANH, 3);
   } else { /* baselines */
      m->chain[0] = m->chain[1] = m->chain[2] = 0;
      w = 0;
      int gats = arch != DN_MLP && dn__chain_has(l, "gat.", 0, DN__GAT_BLOCK);
      int posts = arch == DN_NEUROSKINNING && dn__chain_has(l, "post.", 0, DN__LINEAR);
      l->float_rows = l->float_output = 1;
      if (arch != DN_GAT) w = dn__add_chain(l, "pre.", DN__LINEAR, gats || posts, &in, w, &m->chain[0]);
      if (arch != DN_MLP) w = dn__add_chain(l, "gat.", DN__GAT_BLOCK, posts, &in, w, &m->chain[1]);
      if (arch == DN_NEUROSKINNING) w = dn__add_chain(l, "post.", DN__LINEAR, 0, &in, w, &m->chain[2]);
      out_in = w;
      dn__add_linear(l, "out", &out_in, 3, DN_ACT_NONE);
      if (in == 0) in = out_in;
   }
   m->stage[0].row_width = in;
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
static const char *const dn__arch_names[] = { "mlp", "gat", "neuroskinning", "densegats", "multiresgnet", "garfit_coarse",
                                              "garfitnet", "clothnet", "neuralblendshapes" };
static int dn__is_garment(const dn_model *m)
{
   return m->info.arch == DN_GARFIT_COARSE || m->info.arch == DN_GARFITNET || m->info.arch == DN_CLOTHNET;
}

/* n of "fit:n", which ends at `end`; 0: it is something else */
static size_t dn__fit_of(const char *s, const char *end)
{
   size_t n = 0;
   if (end - s < 5 || memcmp(s, "fit:", 4) != 0) return 0;
   for (s += 4; s < end; s++) {
      if (*s < '0' || *s > '9' || n > DN_MAX_DIM) return 0;
      n = n * 10 + (size_t)(*s - '0');
   }
   return n <= DN_MAX_DIM ? n : 0;
}
static void dn__load_features(dn__loader *l, dn__stage *stage, const char *key)
{
   const char *s = dn__meta(l, key, NULL);
   int garment = dn__is_garment(l->model);
   while (s && !l->failed) {
      const char *end = s;
      size_t i, n = sizeof dn__feature_names / sizeof *dn__feature_names, fit;
      while (*end && *end != ',') end++;
      for (i = 0; i < n; i++)
         if (strlen(dn__feature_names[i].name) == (size_t)(end - s) &&
             !memcmp(s, dn__feature_names[i].name, (size_t)(end - s)))
            break;
      if (i < n && garment && dn__feature_names[i].feature == DN_GEODESIC) i = n; /* a garment is not solid */
      fit = garment && !stage->fit ? dn__fit_of(s, end) : 0;
      if (i == n && !fit)
         dn__meta_fail(l, key, s, garment ? "position, relative, normal, distance, and fit:n at most once"
                       : "position, relative, normal, geodesic, distance");
      else if (stage->feature_count == DN__MAX_FEATURES)
         dn__load_fail(l, DN_UNSUPPORTED, key, ": more than 16 features");
      else stage->features[stage->feature_count++] = i < n ? dn__feature_names[i].feature : DN_FIT;
      if (fit) stage->fit = fit;
      s = *end ? end + 1 : NULL;
   }
}
/* The joint names, split at commas into the model's memory. Returns how many. */
static size_t dn__load_joint_names(dn__loader *l)
{
   const char *list = dn_tensors_meta(l->file, "deformnet.joints");
   size_t names = 1, i, length;
   char *text;
   const char **table;
   if (!list || !*list) return 0;
   for (length = 0; list[length]; length++) names += list[length] == ',';
   if (names > DN_MAX_DIM) { /* bind compares each with the character's */
      char line[120];
      dn__number(line, sizeof line, ": found ", names, " names, expected at most DN_MAX_DIM");
      dn__load_fail(l, DN_BAD_SHAPE, "deformnet.joints", line);
      return 0;
   }
   text = (char *)dn__take(&l->memory, dn__add(length, 1), 1);
   table = (const char **)dn__take(&l->memory, names, sizeof *table);
   if (l->packing && !l->failed) {
      size_t k = 0;
      memcpy(text, list, length + 1);
      table[k++] = text;
      for (i = 0; i < length; i++)
         if (text[i] == ',') text[i] = 0, table[k++] = text + i + 1;
      l->model->info.joint_names = table;
   }
   return names;
}
/* How many columns a per-joint feature of this stage has; the features must make up the row exactly. `joints`: names,
   or what another stage found, 0: not known. Returns the number of joints. */
static size_t dn__load_joints(dn__loader *l, const dn__stage *stage, const char *key, size_t joints)
{
   size_t narrow, wide, found = dn__row_joints(stage, stage->row_width, &narrow, &wide);
   if (!wide) found = joints;
   if (wide ? found == 0 || (joints && found != joints) : stage->row_width != narrow) {
      char line[160];
      dn__text t = dn__text_of(line, sizeof line);
      dn__put(&t, ": the first layer takes rows of ");
      dn__put_size(&t, stage->row_width);
      dn__put(&t, ", the features make ");
      dn__put_size(&t, narrow);
      dn__put(&t, " + ");
      dn__put_size(&t, wide);
      dn__put(&t, " x joints, deformnet.joints names ");
      dn__put_size(&t, joints);
      dn__load_fail(l, DN_BAD_SHAPE, key, line);
   }
   return found;
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
static void dn__load_scales(dn__loader *l, dn__stage *stage, const char *prefix)
{
   char mean_name[DN__NAME], std_name[DN__NAME];
   const float *mean, *std;
   size_t i;
   l->temp.used = 0;
   for (i = 0; i < 3; i++) stage->output_mean[i] = 0.0f, stage->output_std[i] = 1.0f;
   dn__join(mean_name, sizeof mean_name, prefix, "input.mean");
   dn__join(std_name, sizeof std_name, prefix, "input.std");
   if (dn_tensors_find(l->file, mean_name) || dn_tensors_find(l->file, std_name)) {
      float *kept_mean, *kept_scale, *kept_rest;
      mean = dn__maybe(l, mean_name, stage->row_width);
      std = dn__maybe(l, std_name, stage->row_width);
      kept_mean = (float *)dn__take(&l->memory, stage->row_width, sizeof(float));
      kept_scale = (float *)dn__take(&l->memory, stage->row_width, sizeof(float));
      kept_rest = (float *)dn__take(&l->memory, stage->row_width, sizeof(float));
      if (l->packing && !l->failed) {
         for (i = 0; i < stage->row_width; i++) {
            size_t place = dn__place(stage, i);
            kept_mean[place] = mean ? mean[i] : 0.0f;
            dn__two_floats(std ? 1.0 / (double)std[i] : 1.0, &kept_scale[place], &kept_rest[place]);
            if (std && !dn__finite(1.0f / std[i])) {
               char text[80];
               dn__number(text, sizeof text, ": element ", i, " is zero or too small to divide by");
               dn__load_fail(l, DN_BAD_VALUE, std_name, text);
            }
         }
         stage->input_mean = kept_mean;
         stage->input_scale = kept_scale;
         stage->input_rest = kept_rest;
      }
   }
   dn__join(mean_name, sizeof mean_name, prefix, "output.mean");
   dn__join(std_name, sizeof std_name, prefix, "output.std");
   mean = dn__maybe(l, mean_name, 3);
   std = dn__maybe(l, std_name, 3);
   if (l->packing && !l->failed)
      for (i = 0; i < 3; i++)
         stage->output_mean[i] = mean ? mean[i] : 0.0f, stage->output_std[i] = std ? std[i] : 1.0f;
}

/* One run of the builder: metadata, layers, scales. model is the real one when packing, a stand-in when measuring. */
static void dn__load_all(dn__loader *l, size_t blocks)
{
   dn_model *m = l->model;
   size_t arch, joints, archs = sizeof dn__arch_names / sizeof *dn__arch_names;
   int two;
   const char *s = dn__meta(l, "deformnet.version", NULL);
   if (s && !dn__name_equal(s, "1")) dn__meta_fail(l, "deformnet.version", s, "1");
   s = dn__meta(l, "deformnet.arch", NULL);
   if (l->failed) return;
   for (arch = 0; arch < archs && !dn__name_equal(s, dn__arch_names[arch]); arch++) {}
   if (arch == archs) {
      char list[160];
      dn__text t = dn__text_of(list, sizeof list);
      for (arch = 0; arch < archs; arch++) dn__put(&t, arch ? ", " : ""), dn__put(&t, dn__arch_names[arch]);
      dn__meta_fail(l, "deformnet.arch", s, list);
      return;
   }
   m->info.arch = (dn_arch)arch;
   m->info.arch_name = dn__arch_names[arch];
   if (l->precision != DN_PRECISION_F32 && (m->info.arch == DN_NEURALBLENDSHAPES ||
                                            (dn__is_garment(m) && l->precision != DN_PRECISION_F16))) {
      char line[120];
      dn__text t = dn__text_of(line, sizeof line);
      dn__put(&t, ": found ");
      dn__put(&t, dn_precision_name(l->precision));
      dn__put(&t, ", expected f32");
      dn__put(&t, m->info.arch == DN_NEURALBLENDSHAPES ? " for " : " or f16 for ");
      dn__put(&t, m->info.arch_name);
      dn__load_fail(l, DN_UNSUPPORTED, "options.precision", line);
      return;
   }
   two = m->info.arch == DN_CLOTHNET;
   if (m->info.arch != DN_NEURALBLENDSHAPES) dn__load_features(l, &m->stage[0], "deformnet.features");
   if (two) dn__load_features(l, &m->stage[1], "deformnet.features.detail");
   s = dn__meta(l, "deformnet.frame", "model");
   if (!dn__name_equal(s, "model") && !dn__name_equal(s, "root"))
      dn__meta_fail(l, "deformnet.frame", s, "model, root");
   m->info.root_frame = dn__name_equal(s, "root");
   s = dn__meta(l, "deformnet.pooling", "dynamic");
   if (!dn__name_equal(s, "dynamic") && !dn__name_equal(s, "rest"))
      dn__meta_fail(l, "deformnet.pooling", s, "dynamic, rest");
   m->info.pooling = dn__name_equal(s, "rest") ? DN_POOL_REST : DN_POOL_DYNAMIC;
   s = dn__meta(l, "deformnet.unit", "1");
   m->info.unit = dn__decimal(s);
   if (!(m->info.unit > 0.0f)) dn__meta_fail(l, "deformnet.unit", s, "metres per unit, more than 0");
   m->info.licence = dn__keep_string(l, dn__meta(l, "deformnet.licence", ""));
   m->info.trained_on = dn__keep_string(l, dn__meta(l, "deformnet.trained_on", ""));
   m->blocks = (dn__block *)dn__take(&l->memory, blocks, sizeof(dn__block));
   if (l->failed) return;
   if (m->info.arch == DN_NEURALBLENDSHAPES) {
      dn__build_blend(l);
      return;
   }
   dn__build_model(l, m->info.arch);
   if (l->failed) return;
   joints = dn__load_joint_names(l);
   if (!l->failed) joints = dn__load_joints(l, &m->stage[0], "deformnet.features", joints);
   if (!l->failed && two) joints = dn__load_joints(l, &m->stage[1], "deformnet.features.detail", joints);
   m->info.joints = joints;
   dn__load_scales(l, &m->stage[0], two ? "coarse." : "");
   if (two) dn__load_scales(l, &m->stage[1], "detail.");
}
static void dn__load_options(dn__loader *l, const dn_model_options *options)
{
   char line[160];
   dn__text t = dn__text_of(line, sizeof line);
   int k, listed = 0;
   l->precision = options ? options->precision : DN_PRECISION_F32;
   l->kernel = options ? options->kernel : DN_KERNEL_AUTO;
   if (l->kernel == DN_KERNEL_AUTO) l->kernel = dn__kernel_best();
   if (!dn_kernel_available(l->kernel)) {
      dn__put(&t, ": found ");
      dn__put(&t, dn_kernel_name(l->kernel));
      dn__put(&t, ", which does not run here; expected automatic");
      for (k = DN_KERNEL_REF; k < DN_KERNEL_COUNT; k++)
         if (dn_kernel_available((dn_kernel)k)) dn__put(&t, ", "), dn__put(&t, dn_kernel_name((dn_kernel)k));
      dn__load_fail(l, DN_UNSUPPORTED, "options.kernel", line);
   }
   if ((unsigned)l->precision >= (unsigned)DN_PRECISION_COUNT) {
      dn__put(&t, ": found number ");
      dn__put_size(&t, (size_t)(unsigned)l->precision);
      dn__put(&t, ", expected ");
      for (k = 0; k < DN_PRECISION_COUNT; k++)
         dn__put(&t, listed++ ? ", " : ""), dn__put(&t, dn_precision_name((dn_precision)k));
      dn__load_fail(l, DN_UNSUPPORTED, "options.precision", line);
   }
}
/* Measure (memory NULL) or pack. On measuring *bytes and *scratch are written. */
static dn_result dn__load(const dn_tensors *file, const dn_model_options *options, void *memory, size_t *bytes,
                          void *scratch, size_t *scratch_bytes, size_t *blocks, dn_model **model, dn_error *err)
{
   dn__loader l;
   dn_model stand_in;
   memset(&l, 0, sizeof l);
   memset(&stand_in, 0, sizeof stand_in);
   l.file = file;
   l.err = err;
   dn__load_options(&l, options);
   if (l.failed) return l.failed;
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
      return *bytes == SIZE_MAX || *scratch_bytes == SIZE_MAX ? dn__fail(err, DN_NO_MEMORY, dn__where_model,
                                                                         SIZE_MAX, "sizes overflow") : DN_OK;
   }
   {
      dn_model_info *info = &l.model->info;
      const dn__stage *stage = l.model->stage;
      info->precision = l.precision;
      info->kernel = l.kernel;
      info->features = stage[0].features;
      info->feature_count = stage[0].feature_count;
      info->row_width = stage[0].row_width;
      info->fit = stage[0].fit;
      info->detail_features = stage[1].feature_count ? stage[1].features : NULL;
      info->detail_feature_count = stage[1].feature_count;
      info->detail_width = stage[1].row_width;
      info->detail_fit = stage[1].fit;
   }
   l.model->info.bytes = l.memory.used;
   *model = l.model;
   return DN_OK;
}

DN_API dn_result dn_model_size(const dn_tensors *file, const dn_model_options *options, size_t *bytes, size_t *scratch,
                               dn_error *err)
{
   size_t blocks = 0;
   DN_ASSERT(file && bytes && scratch);
   return dn__load(file, options, NULL, bytes, NULL, scratch, &blocks, NULL, err);
}
DN_API dn_result dn_model_init(const dn_tensors *file, const dn_model_options *options, void *memory, size_t bytes,
                               void *scratch, size_t scratch_bytes, dn_model **model, dn_error *err)
{
   size_t need = 0, need_scratch = 0, blocks = 0;
   dn_result r;
   DN_ASSERT(file && memory && scratch && model && ((uintptr_t)memory & 63) == 0 && ((uintptr_t)scratch & 63) == 0);
   *model = NULL;
   r = dn__load(file, options, NULL, &need, NULL, &need_scratch, &blocks, NULL, err);
   if (r) return r;
   if (bytes < need)
      return dn__fail_sizes(err, DN_TOO_SMALL, dn__where_model, SIZE_MAX, "memory: ", bytes, " bytes given, needed ",
                            need, NULL);
   if (scratch_bytes < need_scratch)
      return dn__fail_sizes(err, DN_TOO_SMALL, dn__where_model, SIZE_MAX, "scratch: ", scratch_bytes,
                            " bytes given, needed ", need_scratch, NULL);
   return dn__load(file, options, memory, &bytes, scratch, &scratch_bytes, &blocks, model, err);
}
DN_API dn_model *dn_model_load(const void *file, size_t size, const dn_model_options *options,
                               const dn_allocator *allocator, dn_error *err)
{
   dn_tensors *tensors = NULL;
   dn_model *model = NULL;
   void *table, *memory = NULL, *scratch = NULL;
   size_t table_bytes = 0, bytes = 0, scratch_bytes = 0;
   if (dn_tensors_size(file, size, &table_bytes, err)) return NULL;
   table = dn__alloc(allocator, table_bytes);
   if (!table) {
      dn__fail_sizes(err, DN_NO_MEMORY, dn__where_model, SIZE_MAX, "tensor table of ", table_bytes, NULL, 0,
                     " bytes");
      return NULL;
   }
   if (!dn_tensors_open(file, size, table, table_bytes, &tensors, err) &&
       !dn_model_size(tensors, options, &bytes, &scratch_bytes, err)) {
      memory = dn__alloc(allocator, bytes);
      scratch = memory ? dn__alloc(allocator, scratch_bytes) : NULL;
      if (!scratch)
         dn__fail_sizes(err, DN_NO_MEMORY, dn__where_model, SIZE_MAX, "model of ", bytes, " bytes and scratch of ",
                        scratch_bytes, " bytes");
      else dn_model_init(tensors, options, memory, bytes, scratch, scratch_bytes, &model, err);
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
DN_API dn_model *dn_model_load_file(const char *path, const dn_model_options *options, const dn_allocator *allocator,
                                    dn_error *err)
{
   dn_model *model = NULL;
   FILE *f = fopen(path, "rb");
   size_t size = f ? dn__file_size(f) : SIZE_MAX;
   unsigned char *bytes = NULL;
   if (!f) dn__file_fail(err, DN_IO, path, "cannot open ");
   else if (size == SIZE_MAX) dn__file_fail(err, DN_IO, path, "cannot find the length of ");
   else if (size == 0) dn__file_fail(err, DN_TRUNCATED, path, "found 0 bytes, expected at least 8 in ");
   else if (!(bytes = (unsigned char *)dn__alloc(allocator, size)))
      dn__file_fail(err, DN_NO_MEMORY, path, "no memory for the bytes of ");
   else if (fread(bytes, 1, size, f) != size) dn__file_fail(err, DN_IO, path, "cannot read all of ");
   else model = dn_model_load(bytes, size, options, allocator, err);
   dn__release(allocator, bytes, size);
   if (f) fclose(f);
   return model;
}
#endif

/* --- running. Widths and buffers first: one place says what a frame needs, the runners below only use it. */

/* Rows of nodes: all of them, or as many as are under way. Row n is at + n % ring * pitch; whoever reads or writes count
   rows at once stays within one chunk (dn__wave), and a ring holds whole chunks: they lie one after the other. */
typedef struct dn__rows {
   unsigned char *at;
   size_t pitch; /* bytes from row to row */
   size_t ring;  /* SIZE_MAX: all nodes */
} dn__rows;
static dn__rows dn__rows_of(const void *at, size_t pitch, size_t ring)
{
   dn__rows rows;
   rows.at = (unsigned char *)(uintptr_t)at;
   rows.pitch = pitch;
   rows.ring = ring;
   return rows;
}
static dn__rows dn__column(dn__rows rows, size_t bytes)
{
   rows.at += bytes;
   return rows;
}
static unsigned char *dn__row(const dn__rows *rows, size_t n) { return rows->at + n % rows->ring * rows->pitch; }

/* The memory of a wave (below): the upper fields are given, the others chosen by dn__plan_choose */
typedef struct dn__plan {
   size_t nodes, bandwidth; /* of the graph: the largest |i - j| over its edges, or more */
   size_t depth;            /* how many stages after the first one the last use of a wide row is */
   size_t wide, z, tile;    /* bytes a node: of a wide row, of the widest row of z, of narrow rows that stay in one stage */
   size_t blocks, turns;    /* of attention; buffers of z when they hold all nodes and the blocks take turns */
   size_t cost;             /* multiply-adds a node of all stages, or 0: a step of a small network takes longer chunks */
   size_t chunk, lag, wide_rows, z_rows, z_buffers, bytes;
} dn__plan;
enum { DN__STRIP = 42, /* rows: a multiple of every tile height */
       DN__CHUNK = 4 * DN__STRIP, DN__LONG_CHUNK = 24 * DN__STRIP,
       DN__STEP = 8000000 /* multiply-adds of a step that are worth its parallel loop */ };

typedef enum dn__op_kind { DN__OP_LINEAR, DN__OP_PRODUCTS, DN__OP_ATTEND, DN__OP_COPY, DN__OP_GATHER, DN__OP_SCATTER } dn__op_kind;
typedef struct dn__op { /* one layer, or half of one, on the rows of a chunk */
   dn__op_kind kind;
   size_t stage;
   const dn__block *block;       /* linear; products and attention */
   const char *name;             /* what a probe calls y; NULL: not shown */
   const float *add;             /* (N, the layer's width) linear: see dn_linear, or NULL */
   dn__rows x, y;                /* gather: x are the fine rows; scatter: the coarse ones. Attention reads z */
   size_t width;                 /* of y, numbers */
   dn__cell cell;                /* of y */
   const dn__span *span;         /* what they stand for where they have 8 bits */
   const dn__reduced_text *text; /* copy: of floats into such cells; NULL: as they are */
   unsigned char *z;             /* products, attention: node n is row (n & mask) */
   size_t mask;
   const dn_pool *pool;          /* gather, scatter */
   const dn_clusters *clusters;
} dn__op;

typedef struct dn__extent { /* what decides how much a network needs, besides its model */
   size_t nodes, neighbours /* 2E */, bandwidth;
   size_t coarse_nodes, coarse_bandwidth; /* of any coarse graph, at most */
   const dn_clusters *rest; /* (branches) contractions found at bind, or NULL when there are none: dynamic pooling, and
                               bind itself looking for them */
} dn__extent;
/* with coarse graphs that nothing is known of: clusters are numbered by their smaller member, and the other is at most
   bandwidth away */
static dn__extent dn__extent_of(size_t nodes, size_t neighbours, size_t bandwidth)
{
   dn__extent e;
   e.nodes = e.coarse_nodes = nodes;
   e.neighbours = neighbours;
   e.bandwidth = bandwidth;
   e.coarse_bandwidth = dn__mul(2, bandwidth);
   e.rest = NULL;
   return e;
}

typedef struct dn__net { /* scratch of one evaluation, carved by dn__net_layout or dn__garment_net_layout */
   float *wide;          /* (N, wide_width): x_0 of the modules; garments: what both branches read; baselines: ping */
   float *side;          /* (N, side_width): garments: narrow stages; baselines: pong */
   float *coarse;        /* (M<=N, coarse_width): what is unpooled */
   void *gat;            /* the largest block's product, where blocks run one by one */
   float *shown;         /* (the widest row) what a probe sees of cells */
   size_t wide_width, side_width, coarse_width;
   dn__plan plan[3];     /* of the waves: on the nodes; on the coarse graph; of point-wise layers alone */
   void *work;           /* one wave at a time */
   dn__op *op;           /* its ops */
   size_t op_room;
   float *scores;        /* (2E) dynamic pooling only */
   void *pool;           /* dynamic pooling: scratch of scores and contraction */
   dn_clusters clusters[2]; /* of each branch. dynamic: all arrays here, the same for both; rest: only score is, the rest is the rig's */
   float *length;        /* (N) garments: the second branch's output */
   float *shape;         /* (parser) garments: alpha, beta, theta in the order that the parser reads them */
   float *code[2];       /* (1, its widths) garments: the parser's rows */
} dn__net;
enum { DN__ON_NODES, DN__ON_COARSE, DN__POINTWISE };

typedef struct dn__run { /* what every runner needs at hand */
   const dn_model *m;
   const dn__stage *stage;
   const dn_graph *g;
   const dn__net *n;
   const dn_parallel *par;
   const dn_probe *probe;
   dn_clusters *found;   /* (branches) or NULL. Bind's search: run up to the pools only, contractions go here */
   const float *start;   /* (N, width of the first block) what the bound columns add to it, or NULL */
} dn__run;

static void dn__tap(const dn__run *r, const char *name, const float *rows, size_t first, size_t count, size_t width,
                    size_t stride)
{
   if (r->probe && r->probe->tap) r->probe->tap(r->probe->user, name, rows, first, count, width, stride);
}

/* cells one row after the other, as floats */
static void dn__tap_cells(const dn__run *r, const char *name, const unsigned char *rows, dn__cell cell, const dn__span *span,
                          size_t first, size_t count, size_t width, size_t pitch)
{
   size_t i;
   if (cell == DN__FLOAT) dn__tap(r, name, (const float *)(const void *)rows, first, count, width, pitch / sizeof(float));
   for (i = 0; cell != DN__FLOAT && i < count; i++) {
      dn__floats_of_cells(rows + i * pitch, width, cell, span, r->n->shown);
      dn__tap(r, name, r->n->shown, first + i, 1, width, width);
   }
}

/* --- what a wave does to a range of rows of one block */
static dn__cell dn__reads(const dn__block *b) { return b->reduced.text ? b->reduced.from : DN__FLOAT; }
static dn__cell dn__writes(const dn__block *b) { return b->reduced.text ? b->reduced.to : DN__FLOAT; }
static size_t dn__cell_of(const dn__block *b) { return dn__cell_size(dn__reads(b)); } /* bytes */
static size_t dn__z_pitch(const dn__block *b)
{
   return b->reduced.text ? dn__reduced_z_pitch(&b->reduced) : dn__mul(dn__gat_stride(&b->gat), sizeof(float));
}
/* z (rows, dn__z_pitch) and the self columns of y, activated; y starts with the block's first column */
static void dn__block_products(const dn__block *b, const unsigned char *x, size_t x_pitch, unsigned char *z,
                               unsigned char *y, size_t y_pitch, size_t rows)
{
   if (b->reduced.text) dn__reduced_products(&b->reduced, x, x_pitch, z, dn__z_pitch(b), y, y_pitch, rows);
   else dn__gat_rows(&b->gat, (const float *)(const void *)x, x_pitch / sizeof(float), (float *)(void *)z,
                     (float *)(void *)y, y_pitch / sizeof(float), 0, rows);
}
/* the other columns of y, nodes begin to end - 1; z of node n is row (n & mask), y starts with node `begin` */
static void dn__block_attend(const dn__block *b, const dn_graph *g, const unsigned char *z, size_t mask,
                             unsigned char *y, size_t y_pitch, size_t begin, size_t end)
{
   const dn__kernel *k = dn__kernel_of(b->gat.kernel);
   if (b->reduced.text) dn__reduced_attend(&b->reduced, b->gat.kernel, g, z, dn__z_pitch(b), mask, y, y_pitch, begin, end);
   else (k ? k->attend : dn__attend_ref)(&b->gat, g, (const float *)(const void *)z, mask, (float *)(void *)y,
                                    y_pitch / sizeof(float), begin, end);
}
static void dn__op_rows(const dn__op *op, const dn_graph *g, size_t begin, size_t end)
{
   unsigned char *y = dn__row(&op->y, begin), *x;
   size_t n, most;
   dn_linear layer;
   dn__pool_job pooled;
   switch (op->kind) {
   case DN__OP_LINEAR:
      if (op->block->reduced.text) {
         dn__reduced_products(&op->block->reduced, dn__row(&op->x, begin), op->x.pitch, NULL, 0, y, op->y.pitch, end - begin);
         break;
      }
      layer = op->block->linear;
      if (op->add) layer.add = op->add + begin * layer.out;
      dn__product(&layer, (const float *)(const void *)dn__row(&op->x, begin), op->x.pitch / sizeof(float),
                  (float *)(void *)y, op->y.pitch / sizeof(float), 0, end - begin);
      break;
   case DN__OP_PRODUCTS:
      for (x = dn__row(&op->x, begin); begin < end; begin += n) { /* in two where the ring of z begins again */
         most = op->mask - (begin & op->mask);
         n = end - begin - 1 > most ? most + 1 : end - begin;
         dn__block_products(op->block, x, op->x.pitch, op->z + (begin & op->mask) * dn__z_pitch(op->block), y,
                            op->y.pitch, n);
         x += n * op->x.pitch;
         y += n * op->y.pitch;
      }
      break;
   case DN__OP_ATTEND: dn__block_attend(op->block, g, op->z, op->mask, y, op->y.pitch, begin, end); break;
   case DN__OP_COPY:
      for (n = begin; n < end; n++, y += op->y.pitch) {
         if (!op->text) memcpy(y, dn__row(&op->x, n), op->width * dn__cell_size(op->cell));
         else op->text->cells((const float *)(const void *)dn__row(&op->x, n), op->width, y, op->cell, op->span->inverse,
                              op->span->offset);
      }
      break;
   case DN__OP_GATHER:
   case DN__OP_SCATTER:
   default:
      pooled = dn__pool_job_of(op->pool, NULL, op->clusters);
      pooled.v = (const float *)(const void *)op->x.at;
      pooled.v_stride = op->x.pitch / sizeof(float);
      pooled.y = (float *)(void *)y;
      pooled.y_stride = op->y.pitch / sizeof(float);
      pooled.first = begin;
      pooled.width = op->width;
      (op->kind == DN__OP_GATHER ? dn__pool_gather_range : dn__pool_scatter_range)(&pooled, begin, end, 0);
   }
}

/* --- a wave: several layers on their way over the nodes at once, some nodes apart

        step s      nodes 0 ............................................. N
        stage 0                                     | chunk s |                     products of block 0
        stage 1                 | chunk s - L |                                     attention of 0, products of block 1
        stage 2     | chunk s - 2L |                                                attention of 1, ...

   A block's product reads no rows but a node's own; its attention reads z of neighbours, and those are less than
   bandwidth away: with L = ceil(bandwidth / chunk) + 1 they are all there, made in earlier steps. So all stages of a step
   are independent, one parallel loop runs them, and wide rows live only from stage 0 to the last: in a ring of
   depth L + 1 chunks in place of N rows. So do the rows of z, from a chunk's stage to where the neighbours' attention has
   passed. Where the bandwidth is too large for that to gain anything the rings hold all nodes, and the blocks' z take
   turns in two buffers: z_b+2 overwrites z_b no earlier than attention b has passed, which lies L chunks ahead.
   The order of every sum is that of dn_dense_ref: results do not depend on chunk, lag or ranges. */
static void dn__plan_at(dn__plan *p, size_t chunk)
{
   size_t reach = dn__min(p->bandwidth, p->nodes), window;
   p->chunk = chunk;
   p->lag = (reach + (chunk - 1)) / chunk + 1;
   p->wide_rows = dn__min(p->nodes, dn__mul(dn__add(dn__mul(p->depth, p->lag), 1), chunk));
   window = dn__add(reach, dn__mul(p->lag + 1, chunk)); /* z that attention still reads .. z being written */
   for (p->z_rows = 1; p->z_rows < window && p->z_rows < p->nodes;) p->z_rows *= 2;
   p->z_buffers = p->blocks;
   if (p->z_rows >= p->nodes || dn__mul(p->blocks, p->z_rows) >= dn__mul(p->turns, p->nodes)) {
      p->z_rows = p->nodes;
      p->z_buffers = dn__min(p->blocks, p->turns);
   }
   p->bytes = dn__round(dn__mul(p->wide_rows, p->wide), DN__ALIGN);
   p->bytes = dn__add(p->bytes, dn__mul(p->z_buffers, dn__round(dn__mul(p->z_rows, p->z), DN__ALIGN)));
   p->bytes = dn__add(p->bytes, dn__round(dn__mul(chunk, p->tile), DN__ALIGN));
}
/* Chooses the chunk that needs the least memory. More workers never need less: larger chunks only drop out of the choice. */
static void dn__plan_choose(dn__plan *p, unsigned workers)
{
   size_t least = dn__max(DN__CHUNK, dn__mul(workers, DN__STRIP)), count, chunk;
   if (p->cost) least = dn__max(least, dn__min(DN__STEP / p->cost / DN__STRIP * DN__STRIP, DN__LONG_CHUNK));
   dn__plan best = *p;
   if (p->depth == 0) { /* no attention: long enough to be worth a parallel loop */
      dn__plan_at(p, dn__min(dn__max(2 * DN__CHUNK, least), dn__mul(p->nodes / DN__STRIP + 1, DN__STRIP)));
      return;
   }
   dn__plan_at(&best, dn__min(dn__max(DN__LONG_CHUNK, least), dn__mul(p->nodes / DN__STRIP + 1, DN__STRIP)));
   for (count = 1; p->bandwidth < p->nodes / dn__max(p->depth, 1); count++) { /* the shortest chunk of each lag */
      chunk = ((p->bandwidth + (count - 1)) / count + (DN__STRIP - 1)) / DN__STRIP * DN__STRIP;
      dn__plan_at(p, dn__max(chunk, least));
      if (p->bytes < best.bytes) best = *p;
      if (chunk <= least) break;
   }
   *p = best;
}

enum { DN__MAX_STAGES = 16 };
typedef struct dn__unit { size_t stage, begin, end, rows /* an item's */, item; } dn__unit; /* a stage's chunk of this step */
typedef struct dn__wave {
   const dn__run *r;
   const dn_graph *g;
   const dn__plan *plan;
   dn__op *op;
   size_t ops, stages, cost[DN__MAX_STAGES]; /* of a row, in multiply-adds or so */
   dn__rows wide, tile;
   size_t tile_used;
   unsigned char *z;
   dn__unit unit[DN__MAX_STAGES];
   size_t units;
} dn__wave;

static void dn__wave_open(dn__wave *w, const dn__run *r, const dn_graph *g, size_t which)
{
   const dn__plan *p = &r->n->plan[which];
   dn__arena a = dn__arena_of(r->n->work, p->bytes);
   memset(w, 0, sizeof *w);
   w->r = r;
   w->g = g;
   w->plan = p;
   w->op = r->n->op;
   w->wide = dn__rows_of(dn__take(&a, p->wide_rows, p->wide), p->wide, p->wide_rows < p->nodes ? p->wide_rows : SIZE_MAX);
   w->z = (unsigned char *)dn__take(&a, p->z_buffers, dn__round(p->z_rows * p->z, DN__ALIGN));
   w->tile = dn__rows_of(dn__take(&a, p->chunk, p->tile), p->tile, p->chunk);
   DN_ASSERT(a.used <= p->bytes && g->nodes <= p->nodes);
}
static size_t dn__tile_bytes(size_t width, dn__cell cell) { return dn__round(dn__mul(width, dn__cell_size(cell)), 16); }
/* narrow rows that are read in the stage that writes them */
static dn__rows dn__wave_tile(dn__wave *w, size_t width, dn__cell cell)
{
   dn__rows rows = dn__column(w->tile, w->tile_used);
   w->tile_used += dn__tile_bytes(width, cell);
   DN_ASSERT(w->tile_used <= w->plan->tile);
   return rows;
}
static dn__op *dn__wave_add(dn__wave *w, dn__op_kind kind, size_t stage, const dn__block *b, dn__rows x, dn__rows y,
                            size_t width, size_t cost)
{
   dn__op *op = &w->op[w->ops++];
   DN_ASSERT(w->ops <= w->r->n->op_room && stage < DN__MAX_STAGES);
   memset(op, 0, sizeof *op);
   op->kind = kind;
   op->stage = stage;
   op->block = b;
   op->x = x;
   op->y = y;
   op->width = width;
   w->stages = dn__max(w->stages, stage + 1);
   w->cost[stage] += cost;
   return op;
}
static void dn__wave_linear(dn__wave *w, size_t stage, const dn__block *b, dn__rows x, dn__rows y)
{
   dn__op *op = dn__wave_add(w, DN__OP_LINEAR, stage, b, x, y, b->out, b->in * b->out);
   op->name = b->name;
   op->cell = dn__writes(b);
   op->span = &b->span;
   if (b == w->r->m->blocks) op->add = w->r->start;
}
/* the products of a block in `stage`, its attention in the next one. number: which of the wave's blocks it is; turn: the
   buffer of z that it shares when they hold all nodes */
static void dn__wave_gat(dn__wave *w, size_t stage, const dn__block *b, size_t number, size_t turn, dn__rows x, dn__rows y)
{
   const dn__plan *p = w->plan;
   int whole = p->z_rows >= p->nodes;
   size_t kf = b->gat.heads * b->gat.features, buffer = whole ? turn : number;
   dn__op *products, *attend;
   DN_ASSERT(buffer < p->z_buffers && dn__z_pitch(b) <= p->z);
   products = dn__wave_add(w, DN__OP_PRODUCTS, stage, b, x, y, b->out, b->in * (dn__gat_stride(&b->gat) + b->gat.self));
   attend = dn__wave_add(w, DN__OP_ATTEND, stage + 1, b, y, y, b->out, 48 * kf); /* about six neighbours */
   products->z = attend->z = w->z + buffer * dn__round(p->z_rows * p->z, DN__ALIGN);
   products->mask = attend->mask = whole ? SIZE_MAX : p->z_rows - 1;
   attend->name = b->name;
   attend->cell = dn__writes(b);
   attend->span = &b->span;
}
/* x, floats, to where `reader` finds them as it reads them: y, in its cells */
static void dn__wave_copy(dn__wave *w, size_t stage, dn__rows x, dn__rows y, size_t width, const dn__block *reader,
                          const dn__span *span)
{
   dn__op *op = dn__wave_add(w, DN__OP_COPY, stage, NULL, x, y, width, width);
   op->cell = dn__reads(reader);
   op->span = span;
   if (op->cell != DN__FLOAT) op->text = reader->reduced.text;
}
/* the same in a tile; x itself where the reader reads floats */
static dn__rows dn__wave_cells(dn__wave *w, size_t stage, dn__rows x, size_t width, const dn__block *reader, const dn__span *span)
{
   dn__rows y;
   if (dn__reads(reader) == DN__FLOAT) return x;
   y = dn__wave_tile(w, width, dn__reads(reader));
   dn__wave_copy(w, stage, x, y, width, reader, span);
   return y;
}
static size_t dn__cells_bytes(size_t width, const dn__block *reader) /* of the two tiles that takes */
{
   return dn__add(dn__tile_bytes(width, DN__FLOAT), dn__reads(reader) == DN__FLOAT ? 0 : dn__tile_bytes(width, dn__reads(reader)));
}
/* A dense module (T 3.6) from `stage` on: x_0 stands in the wide row, x_b+1 = f_b(x_b) || x_b grows to the left of it.
   Returns x_m, which is there in stage `stage` + count. */
static dn__rows dn__wave_dense(dn__wave *w, size_t stage, const dn__block *b, size_t count, dn__rows x)
{
   size_t i;
   for (i = 0; i < count; i++) {
      dn__rows f = x;
      f.at -= b[i].out * dn__cell_of(&b[i]);
      dn__wave_gat(w, stage + i, &b[i], i, i % 2, x, f);
      x = f;
   }
   return x;
}
/* post.0, post.1, out: half of a network's arithmetic, whose rows never leave the cache */
static void dn__wave_tail(dn__wave *w, size_t stage, const dn__block *b, dn__rows x, float *y)
{
   dn__rows t0 = dn__wave_tile(w, b[0].out, dn__writes(&b[0])), t1 = dn__wave_tile(w, b[1].out, dn__writes(&b[1]));
   dn__wave_linear(w, stage, &b[0], x, t0);
   dn__wave_linear(w, stage, &b[1], t0, t1);
   dn__wave_linear(w, stage, &b[2], t1, dn__rows_of(y, b[2].out * sizeof(float), SIZE_MAX));
}

/* items begin to end - 1 of this step: some rows of one unit each, of about equal cost */
static void dn__wave_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__wave *w = (const dn__wave *)job;
   size_t item, u = 0, i;
   (void)worker;
   for (item = begin; item < end; item++) {
      size_t from, to;
      while (u + 1 < w->units && w->unit[u + 1].item <= item) u++;
      from = w->unit[u].begin + (item - w->unit[u].item) * w->unit[u].rows;
      to = dn__min(w->unit[u].end, from + w->unit[u].rows);
      for (i = 0; i < w->ops; i++)
         if (w->op[i].stage == w->unit[u].stage) dn__op_rows(&w->op[i], w->g, from, to);
   }
}
static void dn__wave_run(dn__wave *w)
{
   const dn__run *r = w->r;
   size_t chunk = w->plan->chunk, lag = w->plan->lag, nodes = w->g->nodes, workers = dn__workers(r->par);
   size_t chunks = (nodes + (chunk - 1)) / chunk, step, stage, u, i;
   /* weights are read once for so many rows: DN__BLOCK_ROWS where the chunk has them for every worker */
   size_t grain = chunk / DN__BLOCK_ROWS >= workers ? (size_t)DN__BLOCK_ROWS : (size_t)DN__STRIP;
   for (step = 0; chunks > 0 && step < chunks + (w->stages - 1) * lag; step++) {
      size_t items = 0, total = 0, share;
      w->units = 0;
      for (stage = w->stages; stage-- > 0;) { /* the last ones cost the most: they begin */
         dn__unit *unit = &w->unit[w->units];
         if (step < stage * lag || step - stage * lag >= chunks) continue;
         unit->stage = stage;
         unit->begin = (step - stage * lag) * chunk;
         unit->end = dn__min(nodes, unit->begin + chunk);
         total += w->cost[stage] * (unit->end - unit->begin);
         w->units++;
      }
      share = workers > 1 ? total / (8 * workers) : total;
      for (u = 0; u < w->units; u++) {
         dn__unit *unit = &w->unit[u];
         size_t strips = share / (w->cost[unit->stage] * grain + 1);
         unit->rows = workers > 1 ? dn__min(dn__max(strips, 1) * grain, chunk) : chunk;
         unit->item = items;
         items += (unit->end - unit->begin + (unit->rows - 1)) / unit->rows;
      }
      dn__for(r->par, items, 1, dn__wave_range, w);
      for (i = 0; i < w->ops && r->probe; i++) /* on the thread that called, while the rows are there */
         for (u = 0; u < w->units; u++)
            if (w->op[i].name && w->unit[u].stage == w->op[i].stage)
               dn__tap_cells(r, w->op[i].name, dn__row(&w->op[i].y, w->unit[u].begin), w->op[i].cell, w->op[i].span,
                             w->unit[u].begin, w->unit[u].end - w->unit[u].begin, w->op[i].width, w->op[i].y.pitch);
   }
}

/* --- what a frame needs */
static size_t dn__block_scratch(const dn__block *b, size_t count, size_t nodes)
{
   size_t i, need = 0;
   for (i = 0; i < count; i++)
      if (b[i].kind == DN__GAT_BLOCK) need = dn__max(need, dn__mul(nodes, dn__z_pitch(&b[i])));
   return need;
}
static void dn__clusters_layout(dn_clusters *c, size_t nodes, size_t neighbours, dn__arena *a)
{
   c->members = (uint32_t *)dn__take(a, dn__mul(nodes, 2), sizeof(uint32_t));
   c->cluster = (uint32_t *)dn__take(a, nodes, sizeof(uint32_t));
   c->coarse_first = (uint32_t *)dn__take(a, dn__add(nodes, 1), sizeof(uint32_t));
   c->coarse_next = (uint32_t *)dn__take(a, neighbours, sizeof(uint32_t));
}
static size_t dn__blocks_cost(const dn__block *b, size_t count) /* multiply-adds a node */
{
   size_t i, cost = 0;
   for (i = 0; i < count; i++) cost = dn__add(cost, dn__mul(b[i].in, b[i].out));
   return cost;
}
static size_t dn__tail_bytes(const dn__block *post)
{
   return dn__add(dn__tile_bytes(post[0].out, dn__writes(&post[0])), dn__tile_bytes(post[1].out, dn__writes(&post[1])));
}
static size_t dn__widest_z(const dn__block *b, size_t count)
{
   size_t i, z = 0;
   for (i = 0; i < count; i++) z = dn__max(z, dn__z_pitch(&b[i]));
   return z;
}
static void dn__pool_layout(dn__net *n, size_t branches, const dn__extent *e, dn__arena *a)
{
   size_t k;
   float *score;
   n->coarse = (float *)dn__take(a, dn__mul(e->coarse_nodes, n->coarse_width), sizeof(float));
   for (k = 0; e->rest && k < branches; k++) n->clusters[k] = e->rest[k];
   score = (float *)dn__take(a, e->nodes, sizeof(float));
   if (!e->rest) {
      n->scores = (float *)dn__take(a, e->neighbours, sizeof(float));
      n->pool = dn__take(a, dn_pool_scratch(e->nodes, e->neighbours), 1);
      dn__clusters_layout(&n->clusters[0], e->nodes, e->neighbours, a);
      n->clusters[1] = n->clusters[0];
   }
   n->clusters[0].score = n->clusters[1].score = score;
}
static void dn__work_layout(dn__net *n, size_t blocks, unsigned workers, dn__arena *a)
{
   size_t k, bytes = 0;
   for (k = 0; k < sizeof n->plan / sizeof *n->plan; k++) {
      if (n->plan[k].nodes) dn__plan_choose(&n->plan[k], workers);
      bytes = dn__max(bytes, n->plan[k].bytes);
   }
   n->work = dn__take(a, bytes, 1);
   n->op_room = dn__add(dn__mul(blocks, 2), 4); /* a copy or gather, scatter */
   n->op = (dn__op *)dn__take(a, n->op_room, sizeof(dn__op));
}
/* What dn__run_local_global needs of a branch, over what others need. global: its three blocks, the tail behind them;
   wide: bytes of a row that a ring must hold, 0 when the rows of all nodes do */
static void dn__local_global_plan(dn__net *n, const dn__extent *e, const dn__block *global, size_t locals, size_t wide)
{
   dn__plan *p = &n->plan[DN__ON_NODES];
   p->nodes = e->nodes;
   p->bandwidth = e->bandwidth;
   p->depth = dn__max(p->depth, dn__max(locals, 1));
   p->blocks = dn__max(p->blocks, locals + 1);
   p->turns = 3; /* two for the module, one for global.2 beside it */
   p->wide = dn__max(p->wide, wide);
   p->z = dn__max(p->z, dn__widest_z(global - locals, locals + 3));
   p->tile = dn__max(p->tile, dn__add(dn__cells_bytes(global[1].out, global + 2), dn__tail_bytes(global + 3)));
   p->cost = dn__add(dn__blocks_cost(global - locals, locals), dn__blocks_cost(global + 2, 4));
   p = &n->plan[DN__ON_COARSE];
   p->nodes = e->coarse_nodes;
   p->bandwidth = e->coarse_bandwidth;
   p->depth = 1;
   p->blocks = p->turns = 2;
   p->wide = dn__max(p->wide, dn__mul(global[0].out, dn__cell_of(global + 1)));
   p->z = dn__max(p->z, dn__widest_z(global, 2));
   p->tile = dn__max(p->tile, dn__cells_bytes(global[0].in, global));
   p->cost = dn__blocks_cost(global, 2);
   n->coarse_width = dn__max(n->coarse_width, global[1].out);
}
static void dn__net_layout(dn__net *n, const dn_model *m, const dn__extent *e, unsigned workers, dn__arena *a)
{
   const dn__block *b = m->blocks;
   size_t last = m->block_count - 1, i;
   dn__plan *p = n->plan;
   memset(n, 0, sizeof *n);
   if (m->info.arch == DN_DENSEGATS) { /* b: pre 0-1, dense 2-7, transition 8, dense 9-14, transition 15, dense 16-21 */
      p->nodes = e->nodes;
      p->bandwidth = e->bandwidth;
      p->depth = 6;
      p->blocks = 7;
      p->turns = 2;
      for (i = 7; i <= 21; i += 7) p->wide = dn__max(p->wide, dn__mul(dn__add(b[i].in, b[i].out), dn__cell_of(&b[i])));
      p->z = dn__widest_z(b + 2, 20);
      p->tile = dn__max(dn__add(dn__tile_bytes(b[0].out, DN__FLOAT), dn__cells_bytes(b[1].out, b + 2)), dn__tail_bytes(b + 22));
      n->wide_width = dn__max(b[8].out, b[15].out);
   } else if (m->info.arch == DN_MULTIRESGNET) { /* b: pre 0-1, local 2-3, global 4-6, post 7-8, out 9 */
      dn__local_global_plan(n, e, b + 4, 2, dn__mul(b[7].in, dn__cell_of(&b[6])));
      n->wide_width = b[1].out;
      p[DN__POINTWISE].nodes = e->nodes;
      p[DN__POINTWISE].tile = dn__tile_bytes(b[0].out, DN__FLOAT);
      p[DN__POINTWISE].cost = dn__blocks_cost(b, 2);
   } else {
      size_t widest = 0, all = 0;
      for (i = 0; i < last; i++) widest = dn__max(widest, b[i].out), all = dn__add(all, dn__tile_bytes(b[i].out, DN__FLOAT));
      if (m->info.arch == DN_MLP) {
         p[DN__POINTWISE].nodes = e->nodes;
         p[DN__POINTWISE].tile = all;
      } else n->wide_width = n->side_width = widest;
   }
   n->wide = (float *)dn__take(a, dn__mul(e->nodes, n->wide_width), m->info.arch == DN_DENSEGATS ? dn__cell_of(&b[2]) : sizeof(float));
   n->side = (float *)dn__take(a, dn__mul(e->nodes, n->side_width), sizeof(float));
   if (m->info.arch == DN_GAT || m->info.arch == DN_NEUROSKINNING)
      n->gat = dn__take(a, dn__block_scratch(b, m->block_count, e->nodes), 1);
   if (m->info.precision >= DN_PRECISION_BF16) {
      size_t widest = 0;
      for (i = 0; i <= last; i++) widest = dn__max(widest, b[i].out);
      n->shown = (float *)dn__take(a, widest, sizeof(float));
   }
   dn__work_layout(n, m->block_count, workers, a);
   if (m->info.arch == DN_MULTIRESGNET) dn__pool_layout(n, 1, e, a);
}

/* --- how they run */
typedef struct dn__block_job { const dn__run *r; const dn__block *b; const dn_graph *g; dn__rows x, y; const dn__reduced_text *text; const dn__span *span; } dn__block_job;
static void dn__block_range(void *job, size_t begin, size_t end, unsigned worker) /* a layer; the products of a block */
{
   const dn__block_job *j = (const dn__block_job *)job;
   unsigned char *z = j->b->kind == DN__LINEAR ? NULL : (unsigned char *)j->r->n->gat + begin * dn__z_pitch(j->b);
   (void)worker;
   dn__reduced_products(&j->b->reduced, dn__row(&j->x, begin), j->x.pitch, z, z ? dn__z_pitch(j->b) : 0, dn__row(&j->y, begin),
                        j->y.pitch, end - begin);
}
static void dn__attend_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__block_job *j = (const dn__block_job *)job;
   (void)worker;
   dn__block_attend(j->b, j->g, (const unsigned char *)j->r->n->gat, SIZE_MAX, dn__row(&j->y, begin), j->y.pitch, begin, end);
}
static void dn__cells_range(void *job, size_t begin, size_t end, unsigned worker) /* floats to what b reads */
{
   const dn__block_job *j = (const dn__block_job *)job;
   (void)worker;
   for (; begin < end; begin++)
      j->b->reduced.text->cells((const float *)(const void *)dn__row(&j->x, begin), j->b->in, dn__row(&j->y, begin), dn__reads(j->b),
                                j->span->inverse, j->span->offset);
}
/* one block on all nodes: x and y in the cells that it reads and writes */
static void dn__run_block_rows(const dn__run *r, const dn__block *b, const dn_graph *g, dn__rows x, dn__rows y)
{
   const float *from = (const float *)(const void *)x.at;
   float *to = (float *)(void *)y.at;
   if (b->reduced.text) {
      dn__block_job j;
      memset(&j, 0, sizeof j);
      j.r = r;
      j.b = b;
      j.g = g;
      j.x = x;
      j.y = y;
      dn__for(r->par, g->nodes, DN__GRAIN, dn__block_range, &j);
      if (b->kind == DN__GAT_BLOCK) dn__for(r->par, g->nodes, DN__GRAIN, dn__attend_range, &j);
   } else if (b->kind == DN__LINEAR) {
      dn_linear layer = b->linear;
      if (b == r->m->blocks) layer.add = r->start;
      dn_linear_run(&layer, from, x.pitch / sizeof(float), g->nodes, to, y.pitch / sizeof(float), r->par);
   } else dn_gat_run(&b->gat, g, from, x.pitch / sizeof(float), to, y.pitch / sizeof(float), r->n->gat, r->par);
   dn__tap_cells(r, b->name, y.at, dn__writes(b), &b->span, 0, g->nodes, b->out, y.pitch);
}
static void dn__run_block(const dn__run *r, const dn__block *b, const dn_graph *g, const float *x, size_t x_stride,
                          float *y, size_t y_stride)
{
   dn__run_block_rows(r, b, g, dn__rows_of(x, x_stride * sizeof(float), SIZE_MAX), dn__rows_of(y, y_stride * sizeof(float), SIZE_MAX));
}
static dn__rows dn__floats_of(const float *rows, size_t width) { return dn__rows_of(rows, width * sizeof(float), SIZE_MAX); }

/* DenseGATs (T 3.2): 32 -> 464 -> 72 -> 504 -> 72 -> 504 -> 512 -> 128 -> 3 at the paper's size. A wave for each module,
   with what comes before or after it: n->wide has x_0 of the module that runs, and behind it what the transition makes,
   x_0 of the next. */
static void dn__run_densegats(const dn__run *r, const float *rows, float *y)
{
   const dn__net *n = r->n;
   const dn__block *b = r->m->blocks;
   size_t k;
   for (k = 0; k < 3; k++) {
      const dn__block *into = &b[1 + 7 * k], *module = into + 1; /* into: pre.1, transition.0, transition.1 */
      size_t cell = dn__cell_of(module), at = module[5].in + module[5].out - into->out;
      dn__rows x, x0 = dn__rows_of(n->wide, n->wide_width * cell, SIZE_MAX);
      dn__wave w;
      dn__wave_open(&w, r, r->g, DN__ON_NODES);
      x = dn__column(w.wide, at * cell);
      if (k == 0) {
         dn__rows t = dn__wave_tile(&w, b[0].out, DN__FLOAT), u = dn__wave_tile(&w, b[1].out, DN__FLOAT);
         dn__wave_linear(&w, 0, &b[0], dn__floats_of(rows, dn__live_width(r->stage)), t);
         dn__wave_linear(&w, 0, &b[1], t, u);
         dn__wave_copy(&w, 0, u, x, into->out, module, &into->span);
      } else dn__wave_add(&w, DN__OP_COPY, 0, NULL, x0, x, into->out, into->out)->cell = dn__reads(module);
      x = dn__wave_dense(&w, 0, module, 6, x);
      if (k < 2) dn__wave_gat(&w, 6, module + 6, 6, 0, x, x0);
      else dn__wave_tail(&w, 6, b + 22, x, y);
      dn__wave_run(&w);
   }
}

/* A branch's pool on x (N,width). Dynamic pooling sets count and graph in the copy c; the arrays are scratch. Returns 0
   when this is bind's search, which ends here. */
static int dn__run_pool(const dn__run *r, size_t which, const float *x, size_t stride, dn_clusters *c)
{
   const dn__net *n = r->n;
   const dn__branch *q = &r->m->branch[which];
   *c = r->found ? r->found[which] : n->clusters[which];
   if (n->scores) {
      dn_pool_scores(&q->pool, r->g, x, stride, n->scores, n->pool, r->par);
      dn_pool_contract(r->g, n->scores, c, n->pool);
   } else dn_pool_rescore(&q->pool, r->g, x, stride, c, r->par);
   if (r->found) return r->found[which] = *c, 0;
   if (r->probe && r->probe->pool) r->probe->pool(r->probe->user, q->pool_name, c->members, c->score, c->count);
   return 1;
}
/* Around a pool: gather, global.0, global.1 on the coarse graph -> n->coarse (M, global[1].out) */
static void dn__run_coarse(const dn__run *r, const dn__branch *q, const dn_clusters *c, const dn__block *global, dn__rows x)
{
   dn__wave w;
   dn__op *gather;
   dn__rows pooled;
   dn__wave_open(&w, r, &c->graph, DN__ON_COARSE);
   pooled = dn__wave_tile(&w, global[0].in, DN__FLOAT);
   gather = dn__wave_add(&w, DN__OP_GATHER, 0, NULL, x, pooled, global[0].in, 2 * global[0].in);
   gather->pool = &q->pool;
   gather->clusters = c;
   gather->name = q->pool_name;
   pooled = dn__wave_cells(&w, 0, pooled, global[0].in, &global[0], &q->pooled);
   dn__wave_gat(&w, 0, &global[0], 0, 0, pooled, w.wide);
   dn__wave_gat(&w, 1, &global[1], 1, 1, w.wide, dn__floats_of(r->n->coarse, global[1].out));
   dn__wave_run(&w);
}
/* Local and global side by side (T 3.3, 3.13), then the tail. x (N, its width) is what both read. The wide row:

        | local.1 | local.0 | x || global.2 |

   It is x's own when x stands in such a row already (beside != 0), else a ring's. The clothing network has no local part:
   its tail reads the last block alone. */
static void dn__run_local_global(const dn__run *r, size_t which, const dn__block *local, size_t locals, dn__rows x,
                                 int beside, float *y)
{
   const dn__branch *q = &r->m->branch[which];
   const dn__block *global = local + locals;
   size_t cell = dn__cell_of(global + 2), width = global[0].in, stage = locals ? locals - 1 : 0;
   dn_clusters c;
   dn__wave w;
   dn__rows unpooled, g2;
   dn__op *scatter;
   if (!dn__run_pool(r, which, (const float *)(const void *)x.at, x.pitch / sizeof(float), &c)) return;
   dn__run_coarse(r, q, &c, global, x);
   dn__wave_open(&w, r, r->g, DN__ON_NODES);
   g2 = w.wide;
   if (locals) {
      if (!beside) {
         dn__rows x0 = dn__column(w.wide, (global[-1].in + global[-1].out - width) * cell);
         dn__wave_copy(&w, 0, x, x0, width, local, &local[-1].span);
         x = x0;
      }
      dn__wave_dense(&w, 0, local, locals, x);
      g2 = dn__column(x, width * cell);
   }
   unpooled = dn__wave_tile(&w, global[1].out, DN__FLOAT);
   scatter = dn__wave_add(&w, DN__OP_SCATTER, stage, NULL, dn__floats_of(r->n->coarse, global[1].out), unpooled,
                          global[1].out, 2 * global[1].out);
   scatter->pool = &q->pool;
   scatter->clusters = &c;
   scatter->name = q->unpool_name;
   unpooled = dn__wave_cells(&w, stage, unpooled, global[1].out, &global[2], &q->unpooled);
   dn__wave_gat(&w, stage, &global[2], locals, dn__min(locals, 2), unpooled, g2);                       /* T 3.13 */
   g2.at += global[2].out * cell; /* the tail's rows end there */
   g2.at -= global[3].in * cell;
   dn__wave_tail(&w, stage + 1, global + 3, g2, y);
   dn__wave_run(&w);
}
/* MultiResGNet (T 3.3) */
static void dn__run_multiresgnet(const dn__run *r, const float *rows, float *y)
{
   const dn__block *b = r->m->blocks;
   dn__rows x = dn__floats_of(r->n->wide, r->n->wide_width), t;
   dn__wave w;
   dn__wave_open(&w, r, r->g, DN__POINTWISE);
   t = dn__wave_tile(&w, b[0].out, DN__FLOAT);
   dn__wave_linear(&w, 0, &b[0], dn__floats_of(rows, dn__live_width(r->stage)), t);
   dn__wave_linear(&w, 0, &b[1], t, x);
   dn__wave_run(&w);
   dn__run_local_global(r, 0, b + 2, 2, x, 0, y);
}
/* mlp: node by node */
static void dn__run_mlp(const dn__run *r, const float *rows, float *y)
{
   const dn__block *b = r->m->blocks;
   dn__rows x = dn__floats_of(rows, dn__live_width(r->stage));
   size_t i, last = r->m->block_count - 1;
   dn__wave w;
   dn__wave_open(&w, r, r->g, DN__POINTWISE);
   for (i = 0; i < last; i++) {
      dn__rows out = dn__wave_tile(&w, b[i].out, DN__FLOAT);
      dn__wave_linear(&w, 0, &b[i], x, out);
      x = out;
   }
   dn__wave_linear(&w, 0, &b[last], x, dn__floats_of(y, 3));
   dn__wave_run(&w);
}
/* gat, neuroskinning: one block after the other, from one buffer to the other */
static void dn__run_chain(const dn__run *r, const float *rows, float *y)
{
   const dn__block *b = r->m->blocks;
   dn__rows x = dn__floats_of(rows, dn__live_width(r->stage));
   size_t i, made = 0, last = r->m->block_count - 1;
   for (i = 0; i <= last; i++) {
      if (i && dn__writes(&b[i - 1]) == DN__FLOAT && dn__reads(&b[i]) != DN__FLOAT) {
         dn__block_job j;
         memset(&j, 0, sizeof j);
         j.b = &b[i];
         j.span = &b[i - 1].span;
         j.x = x;
         x = j.y = dn__rows_of(made++ % 2 ? r->n->side : r->n->wide, b[i].in * dn__cell_of(&b[i]), SIZE_MAX);
         dn__for(r->par, r->g->nodes, DN__GRAIN, dn__cells_range, &j);
      }
      if (i < last) {
         dn__rows out = dn__rows_of(made++ % 2 ? r->n->side : r->n->wide, b[i].out * dn__cell_size(dn__writes(&b[i])), SIZE_MAX);
         dn__run_block_rows(r, &b[i], r->g, x, out);
         x = out;
      }
   }
   dn__run_block_rows(r, &b[last], r->g, x, dn__floats_of(y, 3));
}
static void dn__run_network(const dn__run *r, const float *rows, float *y)
{
   if (r->m->info.arch == DN_DENSEGATS) dn__run_densegats(r, rows, y);
   else if (r->m->info.arch == DN_MULTIRESGNET) dn__run_multiresgnet(r, rows, y);
   else if (r->m->info.arch == DN_MLP) dn__run_mlp(r, rows, y);
   else dn__run_chain(r, rows, y);
}

/* ===================================================================================== >>garmentnets
   in       rows (N,D) of the garment, alpha, beta, theta      out   displacement (N,3) before output.std/mean
   touches  the frame's scratch
   paper    coarse stage T 4.2, GarFitNet T 4.3, output decomposition T 4.8-4.10, clothing network C 4; spec section 5
   read     dn__build_garment, then dn__run_garfitnet; the blocks, pools and tails they use are in >>networks

   Each network ends in two branches, direction (three channels) and length (one). They run one after the other in the
   same buffers. */

/* --- output decomposition */
static void dn__decompose_one(const float *direction, float length, float *y)
{
   float g[3], size, scale;
   int k;
   for (k = 0; k < 3; k++) g[k] = dn__tanh(direction[k]);                                           /* T 4.9 */
   size = DN_SQRTF(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]);
   scale = dn__activate(length, DN_ACT_RELU) / (size < 1e-12f ? 1.0f : size); /* a NaN passes through */
   for (k = 0; k < 3; k++) y[k] = size < 1e-12f && dn__finite(scale) ? 0.0f : scale * g[k];        /* T 4.8, 4.10 */
}
typedef struct dn__decompose_job { const float *direction, *length; float *y; } dn__decompose_job;
static void dn__decompose_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__decompose_job *j = (const dn__decompose_job *)job;
   size_t i;
   (void)worker;
   for (i = begin; i < end; i++) dn__decompose_one(j->direction + 3 * i, j->length[i], j->y + 3 * i);
}
DN_API void dn_decompose(const float *direction, const float *length, size_t count, float *y)
{
   dn__decompose_job job;
   job.direction = direction;
   job.length = length;
   job.y = y;
   dn__decompose_range(&job, 0, count, 0);
}

/* --- what they are made of */
static const char *const dn__heads[2] = { "dir.", "len." };
static dn_activation dn__head_act(size_t k) { return k == 0 ? DN_ACT_TANH : DN_ACT_RELU; }

/* stem0, stem1, stem2: alpha, beta, theta -> a code as wide as the rows that it multiplies */
static void dn__add_parser(dn__loader *l, const char *stem, size_t code)
{
   size_t k, w = 0;
   for (k = 0; k < 3; k++) {
      char name[DN__NAME];
      size_t in = w;
      dn__number(name, sizeof name, stem, k, "");
      w = dn__add_linear(l, name, &in, k == 2 ? code : 0, DN_ACT_RELU);
      if (k == 0) l->model->info.parser = in;
   }
}
static void dn__build_garment(dn__loader *l, dn_arch arch)
{
   dn__stage *stage = l->model->stage;
   char prefix[DN__NAME], name[DN__NAME];
   size_t k, in, w, x;
   if (arch == DN_GARFIT_COARSE) { /* T 4.2: gat.0-3, dir.out, len.out */
      in = 0;
      w = dn__add_gat(l, "gat.0", &in, DN_ACT_TANH);
      w = dn__add_gats(l, "gat.", 1, 4, w, DN_ACT_TANH);
      stage->row_width = in;
      l->float_rows = l->float_output = 1;
      dn__add_linear(l, "dir.out", &w, 3, DN_ACT_NONE);
      dn__add_linear(l, "len.out", &w, 1, DN_ACT_NONE);
   } else if (arch == DN_GARFITNET) { /* T 4.3: gat.0-1, fit.0-2, then each branch local.0-3, global.0-2, post.0-1, out */
      in = 0;
      x = dn__add_gat(l, "gat.0", &in, DN_ACT_TANH);
      stage->row_width = in;
      w = dn__add_gat(l, "gat.1", &x, DN_ACT_TANH);
      x = dn__add(x, w);
      dn__add_parser(l, "fit.", x);
      for (k = 0; k < 2; k++) {
         w = dn__add_local_global(l, dn__heads[k], k, 4, x, DN_ACT_TANH);
         dn__add_tail(l, dn__heads[k], w, dn__head_act(k), k == 0 ? 3 : 1);
      }
   } else { /* C 4: coarse.gat, each branch gat.0-2, post.0-1, out; then the parser and the detail stage */
      in = 0;
      x = dn__add_gat(l, "coarse.gat", &in, DN_ACT_TANH);
      stage[0].row_width = in;
      for (k = 0; k < 2; k++) {
         dn__join(prefix, sizeof prefix, "coarse.", dn__heads[k]);
         dn__join(name, sizeof name, prefix, "gat.");
         w = dn__add_gats(l, name, 0, 3, x, dn__head_act(k));
         dn__add_tail(l, prefix, w, dn__head_act(k), k == 0 ? 3 : 1);
      }
      in = 0;
      x = dn__add_gat(l, "detail.gat", &in, DN_ACT_TANH);
      stage[1].row_width = in;
      dn__add_parser(l, "parser.", x);
      for (k = 0; k < 2; k++) { /* gat.0, pool, gat.1, gat.2, unpool, gat.3 */
         size_t first = l->model->block_count;
         dn__join(prefix, sizeof prefix, "detail.", dn__heads[k]);
         dn__join(name, sizeof name, prefix, "gat.");
         w = dn__add_gats(l, name, 0, 1, x, dn__head_act(k));
         dn__add_branch(l, prefix, k, first, 0, w);
         w = dn__add_gats(l, name, 1, 4, w, dn__head_act(k));
         dn__add_tail(l, prefix, w, dn__head_act(k), k == 0 ? 3 : 1);
      }
   }
}

/* --- what a frame needs for one stage of a model */
enum { DN__CLOTH_DETAIL = 13 /* clothnet's blocks: 0 coarse.gat, 1-6 and 7-12 its branches, 13 detail.gat, 14-16 parser,
                                17-23 and 24-30 the branches */ };
static size_t dn__stage_of(const dn__run *r) { return (size_t)(r->stage - r->m->stage); }
/* Rows of a whole number of pages would all start in one set of the cache: the next 16 floats set them apart. */
static size_t dn__pitch(size_t width) { return width != 0 && width % 512 == 0 ? dn__add(width, 16) : width; }

/* s: the model's stage */
static void dn__garment_net_layout(dn__net *n, const dn_model *m, size_t s, const dn__extent *e, unsigned workers,
                                   dn__arena *a)
{
   const dn__block *b = m->blocks, *parser = NULL;
   size_t k, plain = m->block_count, pooled = 0, scratch; /* plain: blocks that run one by one */
   dn__plan *tail = &n->plan[DN__POINTWISE];
   memset(n, 0, sizeof *n);
   if (m->info.arch == DN_GARFIT_COARSE) {
      n->wide_width = dn__max(b[0].out, b[2].out);
      n->side_width = dn__max(b[1].out, b[3].out);
   } else if (m->info.arch == DN_GARFITNET) {
      size_t before = 0, after = 0, x = b[1].in + b[1].out;
      plain = 2;
      parser = b + 2;
      pooled = 2;
      for (k = 0; k < 2; k++) {
         const dn__block *global = b + m->branch[k].first + m->branch[k].locals;
         before = dn__max(before, global[-1].in + global[-1].out - x);
         after = dn__max(after, global[2].out);
         dn__local_global_plan(n, e, global, m->branch[k].locals, 0);
      }
      n->wide_width = before + x + after;
   } else if (s == 0) {
      size_t beside = 0;
      for (k = 0; k < 2; k++) {
         const dn__block *q = b + 1 + 6 * k;
         beside = dn__max(beside, dn__max(q[0].out, q[2].out));
         n->side_width = dn__max(n->side_width, q[1].out);
         tail->tile = dn__max(tail->tile, dn__tail_bytes(q + 3));
      }
      tail->nodes = e->nodes;
      n->wide_width = b[0].out + beside;
      plain = DN__CLOTH_DETAIL;
   } else {
      b += DN__CLOTH_DETAIL;
      plain = 1;
      parser = b + 1;
      pooled = 2;
      n->wide_width = b[0].out;
      for (k = 0; k < 2; k++) {
         const dn__block *q = b + 4 + 7 * k;
         n->side_width = dn__max(n->side_width, q[0].out);
         dn__local_global_plan(n, e, q + 1, 0, dn__mul(q[3].out, dn__cell_of(q + 3)));
      }
   }
   n->wide_width = dn__pitch(n->wide_width);
   n->side_width = dn__pitch(n->side_width);
   n->wide = (float *)dn__take(a, dn__mul(e->nodes, n->wide_width), sizeof(float));
   n->side = (float *)dn__take(a, dn__mul(e->nodes, n->side_width), sizeof(float));
   scratch = dn__block_scratch(b, plain, e->nodes);
   for (k = 0; pooled && k < 2 && s == 1; k++) scratch = dn__max(scratch, dn__block_scratch(b + 4 + 7 * k, 1, e->nodes));
   n->gat = dn__take(a, scratch, 1);
   dn__work_layout(n, m->block_count, workers, a);
   n->length = (float *)dn__take(a, e->nodes, sizeof(float));
   if (parser) {
      n->shape = (float *)dn__take(a, m->info.parser, sizeof(float));
      n->code[0] = (float *)dn__take(a, dn__max(parser[0].out, parser[2].out), sizeof(float));
      n->code[1] = (float *)dn__take(a, parser[1].out, sizeof(float));
   }
   if (pooled) dn__pool_layout(n, pooled, e, a);
}

/* --- how they run */
/* relu layers on one row; the code is in n->code[0] */
static void dn__run_parser(const dn__run *r, const dn__block *b)
{
   float *const *code = r->n->code;
   const float *x = r->n->shape;
   size_t k;
   for (k = 0; k < 3; k++) {
      float *y = code[k % 2];
      if (b[k].reduced.text) dn__reduced_products(&b[k].reduced, (const unsigned char *)x, 0, NULL, 0, (unsigned char *)y, 0, 1);
      else dn_linear_run(&b[k].linear, x, b[k].in, 1, y, b[k].out, NULL);
      dn__tap(r, b[k].name, y, 0, 1, b[k].out, b[k].out);
      x = y;
   }
}
typedef struct dn__hadamard_job { float *rows; size_t stride, width; const float *code; } dn__hadamard_job;
static void dn__hadamard_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__hadamard_job *j = (const dn__hadamard_job *)job;
   size_t i, k;
   (void)worker;
   for (i = begin; i < end; i++) {
      float *row = j->rows + i * j->stride;
      for (k = 0; k < j->width; k++) row[k] *= j->code[k];
   }
}
/* the rows (N,width) times the parser's code, which is one row for all nodes */
static void dn__run_hadamard(const dn__run *r, const dn__block *parser, float *rows, size_t stride)
{
   dn__hadamard_job j;
   dn__run_parser(r, parser);
   j.rows = rows;
   j.stride = stride;
   j.width = parser[2].out;
   j.code = r->n->code[0];
   dn__for(r->par, r->g->nodes, DN__TILE, dn__hadamard_range, &j);
   dn__tap(r, "hadamard", rows, 0, r->g->nodes, j.width, stride);
}
/* direction in y, length in n->length -> y */
static void dn__run_decompose(const dn__run *r, float *y)
{
   dn__decompose_job j;
   j.direction = j.y = y;
   j.length = r->n->length;
   dn__for(r->par, r->g->nodes, 1024, dn__decompose_range, &j);
}
/* post.0, post.1, out alone */
static void dn__run_tail(const dn__run *r, const dn__block *b, const float *x, size_t x_stride, float *y)
{
   dn__wave w;
   dn__wave_open(&w, r, r->g, DN__POINTWISE);
   dn__wave_tail(&w, 0, b, dn__floats_of(x, x_stride), y);
   dn__wave_run(&w);
}
static void dn__run_garfit_coarse(const dn__run *r, const float *rows, float *y)
{
   const dn__net *n = r->n;
   const dn__block *b = r->m->blocks;
   dn__run_block(r, &b[0], r->g, rows, dn__live_width(r->stage), n->wide, n->wide_width);
   dn__run_block(r, &b[1], r->g, n->wide, n->wide_width, n->side, n->side_width);
   dn__run_block(r, &b[2], r->g, n->side, n->side_width, n->wide, n->wide_width);
   dn__run_block(r, &b[3], r->g, n->wide, n->wide_width, n->side, n->side_width);
   dn__run_block(r, &b[4], r->g, n->side, n->side_width, y, 3);
   dn__run_block(r, &b[5], r->g, n->side, n->side_width, n->length, 1);
}
/* GarFitNet (T 4.3). The wide row: [ local.3 .. local.0 | gat.1 | gat.0 || global.2 ], the middle two times the code */
static void dn__run_garfitnet(const dn__run *r, const float *rows, float *y)
{
   const dn__net *n = r->n;
   const dn__block *b = r->m->blocks;
   size_t k, at = 0, stride = n->wide_width, x = b[1].in + b[1].out;
   for (k = 0; k < 2; k++) {
      const dn__block *last = b + r->m->branch[k].first + r->m->branch[k].locals - 1;
      at = dn__max(at, last->in + last->out - x);
   }
   dn__run_block(r, &b[0], r->g, rows, dn__live_width(r->stage), n->wide + at + b[1].out, stride);
   dn__run_block(r, &b[1], r->g, n->wide + at + b[1].out, stride, n->wide + at, stride);
   dn__run_hadamard(r, b + 2, n->wide + at, stride);
   for (k = 0; k < 2; k++)
      dn__run_local_global(r, k, r->m->blocks + r->m->branch[k].first, r->m->branch[k].locals,
                           dn__floats_of(n->wide + at, stride), 1, k == 0 ? y : n->length);
}
/* The clothing network's coarse stage (C 4). The wide row: [ coarse.gat | gat.0, later gat.2 ]; gat.1 is in side */
static void dn__run_cloth_coarse(const dn__run *r, const float *rows, float *y)
{
   const dn__net *n = r->n;
   const dn__block *b = r->m->blocks;
   size_t k, stride = n->wide_width;
   float *beside = n->wide + b[0].out;
   dn__run_block(r, &b[0], r->g, rows, dn__live_width(r->stage), n->wide, stride);
   for (k = 0; k < 2; k++) {
      const dn__block *q = b + 1 + 6 * k;
      dn__run_block(r, &q[0], r->g, n->wide, stride, beside, stride);
      dn__run_block(r, &q[1], r->g, beside, stride, n->side, n->side_width);
      dn__run_block(r, &q[2], r->g, n->side, n->side_width, beside, stride);
      dn__run_tail(r, q + 3, beside, stride, k == 0 ? y : n->length);
   }
}
/* and its detail stage: side holds gat.0 */
static void dn__run_cloth_detail(const dn__run *r, const float *rows, float *y)
{
   const dn__net *n = r->n;
   const dn__block *b = r->m->blocks + DN__CLOTH_DETAIL;
   size_t k;
   dn__run_block(r, &b[0], r->g, rows, dn__live_width(r->stage), n->wide, n->wide_width);
   dn__run_hadamard(r, b + 1, n->wide, n->wide_width);
   for (k = 0; k < 2; k++) {
      const dn__block *q = b + 4 + 7 * k;
      dn__run_block(r, &q[0], r->g, n->wide, n->wide_width, n->side, n->side_width);
      dn__run_local_global(r, k, q + 1, 0, dn__floats_of(n->side, n->side_width), 0, k == 0 ? y : n->length);
   }
}
static void dn__run_garment(const dn__run *r, const float *rows, float *y)
{
   if (r->m->info.arch == DN_GARFIT_COARSE) dn__run_garfit_coarse(r, rows, y);
   else if (r->m->info.arch == DN_GARFITNET) dn__run_garfitnet(r, rows, y);
   else if (dn__stage_of(r) == 0) dn__run_cloth_coarse(r, rows, y);
   else dn__run_cloth_detail(r, rows, y);
   if (!r->found) dn__run_decompose(r, y);
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
   dn_kernel kernel;              /* of >>lbs */
   dn_allocator allocator;
   const dn_allocator *allocator_used; /* NULL: DN_MALLOC, or &allocator */
   int owned;
   size_t bytes;
   size_t bandwidth;              /* the largest |i - j| over the edges of the graph */
   uint32_t root;                 /* the character's joint that is the model's joint 0 */
   const uint32_t *fold;          /* (S) joint that the network sees in place of joint s, or NULL: itself */
   const uint32_t *corner_first, *corner_tri; /* triangles at each node, for the normals */
   const float *rest_vertices;    /* (V,3): with a weld distance, vertices of a node rest apart */
   const float *start;            /* (N, width of the first block): dn_model.bound of each node, or NULL */
   int has_clusters;              /* rest pooling */
   dn_clusters clusters;
   size_t coarse_bandwidth;       /* of their graph */
};

typedef struct dn__bind { /* bind's scratch: the mesh in the library's own form */
   const char *where;             /* for errors: "bind", or which mesh of a garment */
   int bare;                      /* the mesh has no skin, and needs none */
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
   size_t bandwidth;              /* the largest |i - j| over all edges */
   void *work;                    /* scratch of one step at a time */
   size_t work_bytes;
} dn__bind;

#define DN__MOST ((size_t)0x7fffffff / 8) /* vertices, triangles: 6 per triangle and 3 per vertex stay 32-bit indices */
static const char dn__where_bind[] = "bind";
static dn_result dn__bind_fail(const dn__bind *b, dn_result code, const char *what, size_t index, const char *problem)
{
   return dn__fail_sizes(b->err, code, b->where, index, what, index, NULL, 0, problem);
}
/* "triangle 7: vertex index 99, expected below 42" */
static dn_result dn__bind_range(const dn__bind *b, dn_result code, const char *what, size_t at, const char *found,
                                size_t value, size_t limit)
{
   char line[240];
   dn__text t = dn__text_of(line, sizeof line);
   dn__put(&t, what);
   dn__put_size(&t, at);
   dn__put(&t, found);
   dn__put_size(&t, value);
   dn__put(&t, ", expected below ");
   dn__put_size(&t, limit);
   return dn__fail(b->err, code, b->where, at, line);
}
static int dn__step(const dn__bind *b, const char *stage, float done) /* non-zero: cancelled */
{
   const dn_progress *p = b->desc->progress;
   return p && p->step && p->step(p->user, stage, done);
}
static dn_result dn__cancelled(const dn__bind *b) { return dn__fail(b->err, DN_CANCELLED, b->where, SIZE_MAX, "cancelled by the progress callback"); }

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
   return dn__weight_at(s->weights, s->weight_type, v * dn__stride(s->weight_stride,
                                                                   s->influences * size) + k * size);
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
static dn_result dn__bind_open(dn__bind *b, const dn_model *model, const dn_rig_desc *desc, const char *where,
                               int bare, dn_error *err)
{
   const dn_mesh *m = &desc->mesh;
   size_t v, s, k, i;
   memset(b, 0, sizeof *b);
   b->where = where;
   b->bare = bare;
   b->model = model;
   b->desc = desc;
   b->err = err;
   b->vertices = m->vertices;
   b->triangles = m->triangles;
   b->joints = desc->skeleton.joints;
   if (model && model->info.arch > DN_MULTIRESGNET) {
      char line[120];
      dn__join3(line, sizeof line, "the model is of the kind ", model->info.arch_name,
                dn__is_garment(model) ? ", which dn_garment_create takes" : ", which dn_blend_create takes");
      return dn__fail(err, DN_UNSUPPORTED, where, SIZE_MAX, line);
   }
   if (m->vertices == 0) return dn__fail(err, DN_BAD_MESH, where, SIZE_MAX, "no vertices");
   if (!bare && (b->joints == 0 || m->skin_sets == 0))
      return dn__fail(err, DN_BAD_SKIN, where, SIZE_MAX, "no joints or no skin weights: the mesh is not skinned");
   if (m->vertices > DN__MOST || m->triangles > DN__MOST)
      return dn__fail_sizes(err, DN_BAD_MESH, where, SIZE_MAX, m->vertices > DN__MOST ? "vertices: found "
                            : "triangles: found ", m->vertices > DN__MOST ? m->vertices : m->triangles,
                            ", expected at most ", DN__MOST, NULL);
   if (b->joints > DN_MAX_DIM)
      return dn__fail_sizes(err, DN_BAD_SKIN, where, SIZE_MAX, "joints: found ", b->joints, ", expected at most ",
                            DN_MAX_DIM, NULL);
   DN_ASSERT(m->positions && (bare || m->skin) && (m->triangles == 0 || m->indices));
   DN_ASSERT(m->triangles == 0 || m->index_type == DN_U16 || m->index_type == DN_U32);
   DN_ASSERT(desc->order == DN_ORDER_GIVEN || desc->order == DN_ORDER_NEAR);
   for (s = 0; !bare && s < m->skin_sets; s++) {
      if (m->skin[s].influences == 0) continue;
      DN_ASSERT(m->skin[s].joints && m->skin[s].weights);
      DN_ASSERT(m->skin[s].joint_type == DN_U8 || m->skin[s].joint_type == DN_U16 || m->skin[s].joint_type == DN_U32);
      DN_ASSERT(m->skin[s].weight_type == DN_F32 || m->skin[s].weight_type == DN_U8N ||
                m->skin[s].weight_type == DN_U16N);
   }
   if (desc->resolution > 512)
      return dn__fail_sizes(err, DN_BAD_VALUE, where, SIZE_MAX, "resolution ", desc->resolution, ", at most ", 512,
                            NULL);
   if (desc->kernel != DN_KERNEL_AUTO && !dn_kernel_available(desc->kernel))
      return dn__fail(err, DN_UNSUPPORTED, where, SIZE_MAX, "kernel: found one that does not run here, expected automatic");
   if (!dn__finite(desc->weld_distance))
      return dn__fail(err, DN_BAD_VALUE, where, SIZE_MAX, "weld_distance is not finite");
   if (bare) return DN_OK;
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
      for (i = 0; i < model->info.feature_count; i++) b->wants_geodesic |= model->stage[0].features[i] == DN_GEODESIC;
      b->wants_clusters = model->info.arch == DN_MULTIRESGNET && model->info.pooling == DN_POOL_REST;
      b->model_joints = model->info.joints;
   }
   return DN_OK;
}
static unsigned dn__resolution(const dn_rig_desc *d) { return d->resolution ? d->resolution : 128; }

/* --- layouts: one for scratch (from the counts and the bounding box), one for the rig (bounds, or exact once welded) */
static size_t dn__frame_bytes(const dn_model *m, size_t vertices, const dn__extent *e, size_t joints, int dual,
                              unsigned workers);
/* dn_geodesic_scratch before there are nodes: what it needs depends on the bounding box only. Welding over a distance
   moves each face of the box in by at most that much; where the longest side shrinks, the cells do, and the other sides
   take more of them. */
static size_t dn__geodesic_scratch_box(float box[6], size_t nodes, float weld_distance, unsigned resolution,
                                       unsigned workers)
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
      work = dn__max(work, dn__geodesic_scratch_box(box, V, b->desc->weld_distance, dn__resolution(b->desc),
                                                    workers));
   }
   if (b->wants_clusters) { /* the network up to its pool, on the rest pose; any bandwidth needs no more than this one */
      dn__extent most = dn__extent_of(V, neighbours, SIZE_MAX);
      work = dn__max(work, dn__add(dn__mul(b->joints, 12 * sizeof(float) + DN__ALIGN),
                                   dn__frame_bytes(b->model, V, &most, b->joints, b->desc->skinning == DN_DQS,
                                                   workers)));
   }
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
   r->start = b->model && b->model->bound.in ? (float *)dn__take(a, dn__mul(nodes, b->model->bound.out), sizeof(float)) : NULL;
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
      if (b->influences)
         memset(joint, 0, b->influences * sizeof *joint), memset(weight, 0, b->influences * sizeof *weight);
      dn__position_at(m, v, b->positions + 3 * v);
      for (k = 0; k < 3; k++)
         if (!dn__finite(b->positions[3 * v + k]))
            return dn__bind_fail(b, DN_BAD_MESH, "vertex ", v, ": its position is not finite");
      if (b->bare) continue;
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
         if (v >= b->vertices)
            return dn__bind_range(b, DN_BAD_MESH, "triangle ", t, ": vertex index ", v, b->vertices);
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
      const float *x = b->positions + 3 * (size_t)b->first_vertex[q[0]],
         *y = b->positions + 3 * (size_t)b->first_vertex[q[1]];
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
/* renumbers the welded nodes so that neighbours are near: everything that is made after this is in that order */
static void dn__bind_order(dn__bind *b, const dn_graph *g)
{
   uint32_t *place = (uint32_t *)b->work, *first_vertex = place + b->nodes; /* (N) each */
   size_t i;
   dn__graph_near(g, place, first_vertex);
   memcpy(first_vertex, b->first_vertex, b->nodes * sizeof *first_vertex);
   for (i = 0; i < b->nodes; i++) b->first_vertex[place[i]] = first_vertex[i];
   for (i = 0; i < b->vertices; i++) b->node_of_vertex[i] = place[b->node_of_vertex[i]];
   for (i = 0; i < 3 * b->triangles; i++) b->triangle[i] = place[b->triangle[i]];
}
static dn_result dn__bind_prepare(dn__bind *b)
{
   dn_graph g;
   dn_result r;
   if (dn__step(b, "weld", 0.0f)) return dn__cancelled(b);
   if ((r = dn__bind_skin(b)) != DN_OK) return r;
   b->nodes = dn__weld(b->positions, b->vertices, b->bare ? NULL : b->joint, b->bare ? NULL : b->weight,
                       b->influences, b->desc->weld_distance, b->node_of_vertex, b->first_vertex,
                       &b->report.seams_apart, b->work, b->desc->progress);
   if (b->nodes == SIZE_MAX) return dn__cancelled(b);
   if ((r = dn__bind_triangles(b)) != DN_OK) return r;
   if (dn__step(b, "graph", 0.0f)) return dn__cancelled(b);
   if (dn__graph_build(b->triangle, b->triangles, b->nodes, b->first, b->next, &g, b->work, b->desc->progress))
      return dn__cancelled(b);
   if (b->desc->order == DN_ORDER_NEAR) {
      if (dn__step(b, "order", 0.0f)) return dn__cancelled(b);
      dn__bind_order(b, &g);
      if (dn__graph_build(b->triangle, b->triangles, b->nodes, b->first, b->next, &g, b->work, b->desc->progress))
         return dn__cancelled(b);
   }
   b->neighbours = b->first[b->nodes];
   b->bandwidth = dn__graph_bandwidth(&g);
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
   return dn__fail(b->err, DN_MISSING_JOINT, b->where, SIZE_MAX, line);
}
static dn_result dn__bind_joints(dn__bind *b, uint32_t *map, uint32_t *fold)
{
   const dn_skeleton *sk = &b->desc->skeleton;
   const char *const *want = b->model ? b->model->info.joint_names : NULL;
   size_t s, k;
   for (k = 0; k < b->joints; k++) fold[k] = (uint32_t)k;
   if (!want) { /* by index */
      if (b->model_joints && b->model_joints != b->joints)
         return dn__fail_sizes(b->err, DN_MISSING_JOINT, b->where, SIZE_MAX, "the skeleton has ", b->joints,
                               " joints, the model ", b->model_joints, " and no names");
      for (s = 0; s < b->model_joints; s++) map[s] = (uint32_t)s;
      b->report.joints_matched = b->model_joints;
      return DN_OK;
   }
   if (!sk->names)
      return dn__fail(b->err, DN_MISSING_JOINT, b->where, SIZE_MAX,
                      "the model names its joints, the skeleton has no names");
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
         return dn__bind_fail(b, DN_BAD_SKIN, "joint ", (size_t)map[s],
                              ": its inverse bind matrix cannot be inverted");
   }
   return DN_OK;
}

/* --- step 3: what depends on the model */
static dn_result dn__bind_geodesic(dn__bind *b, const dn_rig *r, float *geodesic)
{
   dn_result result;
   if (b->desc->geodesic) {
      size_t i, v, n = b->nodes * b->model_joints;
      if (b->desc->geodesic_nodes != b->nodes)
         return dn__fail_sizes(b->err, DN_BAD_SHAPE, b->where, SIZE_MAX, "geodesic: ", b->desc->geodesic_nodes,
                               " nodes given, the mesh has ", b->nodes, NULL);
      for (i = 0; i < n; i++)
         if (!dn__finite(b->desc->geodesic[i]))
            return dn__bind_fail(b, DN_BAD_VALUE, "geodesic: node ", i / b->model_joints,
                                 " has a distance that is not finite");
      for (v = 0, i = 0; v < b->vertices; v++) { /* the i-th vertex that starts a node brings row i */
         size_t node = r->view.node_of_vertex[v];
         if (r->view.first_vertex[node] != v) continue;
         memcpy(geodesic + node * b->model_joints, b->desc->geodesic + i++ * b->model_joints,
                b->model_joints * sizeof *geodesic);
      }
      return DN_OK;
   }
   result = dn_geodesic(r->view.rest, b->nodes, r->view.triangle, b->kept, r->view.joint_rest, b->model_joints,
                        dn__resolution(b->desc), geodesic, &b->report.solid_cells, &b->report.cell, b->work,
                        b->work_bytes, b->desc->parallel, b->desc->progress);
   return result == DN_OK ? DN_OK : result == DN_CANCELLED ? dn__cancelled(b)
      : dn__fail(b->err, result, b->where, SIZE_MAX, "geodesic distances");
}
/* start_i = bn(W x_i + b), x_i the bound columns of node i, normalised: in double, like the rest of what is rounded once */
typedef struct dn__start_job { const dn_rig *r; float *start; } dn__start_job;
static void dn__start_range(void *job, size_t begin, size_t end, unsigned worker)
{
   enum { ROWS = 8 };
   const dn__start_job *j = (const dn__start_job *)job;
   const dn_linear *l = &j->r->model->bound;
   const dn__stage *stage = &j->r->model->stage[0];
   size_t joints = j->r->model->info.joints, live = dn__live_width(stage), p, c, i, k, rows;
   (void)worker;
   for (; begin < end; begin += rows) {
      const float *geodesic = j->r->view.geodesic + begin * joints;
      rows = dn__min(ROWS, end - begin);
      for (p = 0; p * DN_PANEL < l->out; p++) {
         const float *w = l->panels + p * l->in * DN_PANEL, *n = l->columns + p * DN__COLUMN; /* dn__product_ref's numbers */
         double sum[ROWS][DN_PANEL];
         for (i = 0; i < ROWS; i++)
            for (k = 0; k < DN_PANEL; k++) sum[i][k] = (double)n[k] + (double)n[DN_PANEL + k];
         for (c = 0; c < l->in; c++, w += DN_PANEL) {
            double mean = stage->input_mean ? (double)stage->input_mean[live + c] : 0.0;
            double scale = stage->input_mean ? (double)stage->input_scale[live + c] + (double)stage->input_rest[live + c] : 1.0;
            for (i = 0; i < rows; i++) {
               double x = ((double)geodesic[i * joints + c % joints] - mean) * scale; /* listed twice: both read the same */
               for (k = 0; k < DN_PANEL; k++) sum[i][k] += x * (double)w[k];
            }
         }
         for (i = 0; i < rows; i++)
            for (k = 0; k < dn__min(DN_PANEL, l->out - p * DN_PANEL); k++)
               j->start[(begin + i) * l->out + p * DN_PANEL + k] =
                  dn__narrow(sum[i][k] * ((double)n[2 * DN_PANEL + k] + (double)n[3 * DN_PANEL + k]) + (double)n[4 * DN_PANEL + k]);
      }
   }
}
static void dn__bind_start(dn__bind *b, dn_rig *r)
{
   dn__start_job job;
   job.r = r;
   job.start = (float *)r->start;
   dn__for(b->desc->parallel, b->nodes, 512, dn__start_range, &job);
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
   r->bandwidth = b->bandwidth;
   r->kernel = b->desc->kernel != DN_KERNEL_AUTO ? b->desc->kernel : b->model ? b->model->info.kernel : dn__kernel_best();
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
   for (i = 0; i < N; i++)
      memcpy((float *)v->rest + 3 * i, b->positions + 3 * (size_t)b->first_vertex[i], 3 * sizeof(float));
   dn__corners_build(v->triangle, b->kept, N, (uint32_t *)r->corner_first, (uint32_t *)r->corner_tri);
   if ((result = dn__bind_joints(b, map, fold)) != DN_OK) return result;
   if ((result = dn__bind_joint_rest(b, map, (float *)v->joint_rest)) != DN_OK) return result;
   r->root = b->model_joints ? map[0] : 0;
   if (b->report.joints_folded == 0) r->fold = NULL;
   if (b->wants_geodesic && (result = dn__bind_geodesic(b, r, (float *)v->geodesic)) != DN_OK) return result;
   if (r->start) dn__bind_start(b, r);
   if (b->wants_clusters && (result = dn__bind_clusters(b, r)) != DN_OK) return result;
   dn__step(b, "done", 1.0f);
   return DN_OK;
}

DN_API dn_result dn_rig_size(const dn_model *model, const dn_rig_desc *desc, size_t *bytes, size_t *scratch,
                             dn_error *err)
{
   dn__bind b;
   dn__arena kept = dn__arena_of(NULL, 0), temp = dn__arena_of(NULL, 0);
   dn_rig measure;
   dn_result r;
   DN_ASSERT(desc && bytes && scratch);
   if ((r = dn__bind_open(&b, model, desc, dn__where_bind, 0, err)) != DN_OK) return r;
   dn__take(&kept, 1, sizeof(dn_rig));
   dn__rig_layout(&measure, &b, b.vertices, dn__mul(b.triangles, 6), b.triangles, &kept);
   dn__bind_memory(&b, &temp);
   *bytes = kept.used;
   *scratch = temp.used;
   return *bytes == SIZE_MAX || *scratch == SIZE_MAX ? dn__fail(err, DN_NO_MEMORY, dn__where_bind, SIZE_MAX,
                                                                "sizes overflow") : DN_OK;
}
/* a prepared bind into memory of exactly the right size */
static dn_result dn__rig_build(dn__bind *b, void *memory, size_t bytes, dn_rig **rig)
{
   dn__arena kept = dn__arena_of(memory, bytes);
   dn_rig *r = (dn_rig *)dn__take(&kept, 1, sizeof(dn_rig));
   dn_result result;
   if (!r)
      return dn__fail_sizes(b->err, DN_TOO_SMALL, dn__where_bind, SIZE_MAX, "memory: ", bytes,
                            " bytes given, too small", 0, NULL);
   memset(r, 0, sizeof *r);
   dn__rig_layout(r, b, b->nodes, b->neighbours, b->kept, &kept);
   if (kept.used > bytes)
      return dn__fail_sizes(b->err, DN_TOO_SMALL, dn__where_bind, SIZE_MAX, "memory: ", bytes,
                            " bytes given, needed ", kept.used, NULL);
   r->bytes = kept.used;
   if ((result = dn__bind_finish(b, r)) != DN_OK) return result;
   r->view.bytes = r->bytes;
   *rig = r;
   return DN_OK;
}
static dn_result dn__bind_begin(dn__bind *b, const dn_model *model, const dn_rig_desc *desc, void *scratch,
                                size_t scratch_bytes, dn_error *err)
{
   dn__arena temp = dn__arena_of(scratch, scratch_bytes);
   dn_result r = dn__bind_open(b, model, desc, dn__where_bind, 0, err);
   if (r != DN_OK) return r;
   dn__bind_memory(b, &temp);
   if (temp.used > scratch_bytes)
      return dn__fail_sizes(err, DN_TOO_SMALL, dn__where_bind, SIZE_MAX, "scratch: ", scratch_bytes,
                            " bytes given, needed ", temp.used, NULL);
   return dn__bind_prepare(b);
}
DN_API dn_result dn_rig_init(const dn_model *model, const dn_rig_desc *desc, void *memory, size_t bytes,
                             void *scratch, size_t scratch_bytes, dn_rig **rig, dn_report *report, dn_error *err)
{
   dn__bind b;
   dn_result r;
   DN_ASSERT(desc && memory && scratch && rig && ((uintptr_t)memory & 63) == 0 && ((uintptr_t)scratch & 63) == 0);
   *rig = NULL;
   r = dn__bind_begin(&b, model, desc, scratch, scratch_bytes, err);
   if (r == DN_OK) r = dn__rig_build(&b, memory, bytes, rig);
   if (r == DN_OK && report) *report = b.report;
   return r;
}
DN_API dn_rig *dn_rig_create(const dn_model *model, const dn_rig_desc *desc, const dn_allocator *allocator,
                             dn_report *report, dn_error *err)
{
   dn__bind b;
   dn_rig *rig = NULL;
   size_t bytes = 0, scratch_bytes = 0;
   void *scratch, *memory = NULL;
   if (dn_rig_size(model, desc, &bytes, &scratch_bytes, err) != DN_OK) return NULL;
   scratch = dn__alloc(allocator, scratch_bytes);
   if (!scratch) {
      dn__fail_sizes(err, DN_NO_MEMORY, dn__where_bind, SIZE_MAX, "bind scratch of ", scratch_bytes, NULL, 0,
                     " bytes");
      return NULL;
   }
   if (dn__bind_begin(&b, model, desc, scratch, scratch_bytes, err) == DN_OK) { /* welded: the rig's size is exact now */
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

enum { DN__TALLY = 1024 };    /* a multiple of this many nodes or vertices goes to a worker at a time */
typedef struct dn__tally {    /* what one such run found; added up in order once all are done */
   float low[3], high[3];     /* box of its vertices */
   uint32_t fallen;           /* its nodes that the network left not finite */
} dn__tally;
typedef struct dn__frame {    /* the scratch, carved the same way by every stage */
   float *palette;            /* (S,12) model space */
   float *wide;               /* (S,16) the same, each joint on a cache line; LBS only */
   float *seen;               /* (S,12) what the network sees: root frame, extra joints folded */
   float *dual;               /* (S,8) dual quaternions of palette, DQS only */
   float *posed;              /* (3, S_model rounded up) joints, in the network's frame: dn__posed_joints */
   float *root;               /* (9) rotation of the network's frame, identity for "model" */
   float *skinned;            /* (V,3) model space */
   float *coarse;             /* (N,3) model space */
   double *framed;            /* (N,3) coarse in the network's frame, not rounded: the normals need it */
   float *refined;            /* (N,3) in the same memory, once the network has run */
   float *normals;            /* (N,3) of framed; later of refined */
   float *rows;               /* (N, live columns), normalised */
   float *displacement;       /* (N,3) network's frame, then model space */
   uint32_t *state;           /* (3) fallback nodes, finite palette, skinned by LBS here */
   dn__tally *tally;          /* (V / DN__TALLY, rounded up) */
   dn__net net;
} dn__frame;

static void dn__frame_layout(dn__frame *f, const dn_model *m, size_t vertices, const dn__extent *e, size_t joints, int dual,
                             unsigned workers, dn__arena *a)
{
   size_t nodes = e->nodes, width = m ? dn__live_width(&m->stage[0]) : 0;
   memset(f, 0, sizeof *f);
   f->palette = (float *)dn__take(a, dn__mul(joints, 12), sizeof(float));
   f->wide = dual ? NULL : (float *)dn__take(a, dn__mul(joints, 16), sizeof(float));
   f->seen = (float *)dn__take(a, dn__mul(joints, 12), sizeof(float));
   f->dual = dual ? (float *)dn__take(a, dn__mul(joints, 8), sizeof(float)) : NULL;
   f->posed = (float *)dn__take(a, dn__mul(dn__posed_pitch(m ? m->info.joints : 0), 3), sizeof(float));
   f->root = (float *)dn__take(a, 9, sizeof(float));
   f->skinned = (float *)dn__take(a, dn__mul(vertices, 3), sizeof(float));
   f->coarse = (float *)dn__take(a, dn__mul(nodes, 3), sizeof(float));
   f->framed = (double *)dn__take(a, dn__add(dn__mul(nodes, 3), 1), m ? sizeof(double) : sizeof(float)); /* and one to load past the end */
   f->refined = (float *)f->framed;
   f->normals = (float *)dn__take(a, dn__mul(nodes, 3), sizeof(float));
   f->displacement = (float *)dn__take(a, dn__mul(nodes, 3), sizeof(float));
   f->state = (uint32_t *)dn__take(a, 3, sizeof(uint32_t));
   f->tally = (dn__tally *)dn__take(a, vertices / DN__TALLY + 1, sizeof(dn__tally));
   f->rows = (float *)dn__take(a, dn__mul(nodes, width), sizeof(float));
   if (m) dn__net_layout(&f->net, m, e, workers, a);
}
static size_t dn__frame_bytes(const dn_model *m, size_t vertices, const dn__extent *e, size_t joints, int dual,
                              unsigned workers)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn__frame f;
   dn__frame_layout(&f, m, vertices, e, joints, dual, workers, &a);
   return a.used;
}
static dn__extent dn__rig_extent(const dn_rig *r)
{
   dn__extent e = dn__extent_of(r->view.nodes, r->view.graph.first[r->view.nodes], r->bandwidth);
   if (!r->has_clusters) return e;
   e.rest = &r->clusters;
   e.coarse_nodes = r->clusters.count;
   e.coarse_bandwidth = r->coarse_bandwidth;
   return e;
}
static dn__frame dn__frame_of(const dn_rig *r, void *scratch, unsigned workers)
{
   dn__arena a = dn__arena_of(scratch, SIZE_MAX / 2);
   dn__extent e = dn__rig_extent(r);
   dn__frame f;
   dn__frame_layout(&f, r->model, r->view.vertices, &e, r->view.joints, r->skinning == DN_DQS, workers, &a);
   return f;
}
DN_API size_t dn_scratch_size(const dn_rig *r, unsigned workers)
{
   dn__extent e = dn__rig_extent(r);
   return dn__frame_bytes(r->model, r->view.vertices, &e, r->view.joints, r->skinning == DN_DQS, workers ? workers : 1);
}
DN_API void *dn_scratch_create(const dn_rig *r, unsigned workers, const dn_allocator *allocator, size_t *bytes,
                               dn_error *err)
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
      for (v = begin; v < end; v++)
         memcpy(j->f->skinned + 3 * v, (const unsigned char *)j->pose->skinned + v * stride, 12);
   } else if (r->skinning == DN_DQS)
      dn__dqs_range(r->rest_vertices, r->view.skin_joint, r->view.skin_weight, r->view.influences, j->f->dual, begin,
                    end, j->f->skinned);
   else dn__lbs_run(r->kernel, r->rest_vertices, r->view.skin_joint, r->view.skin_weight, r->view.influences,
                    j->f->palette, j->f->wide, begin, end, j->f->skinned);
}
DN_API dn_result dn_stage_skin(const dn_rig *rig, const dn_pose *pose, void *scratch, size_t scratch_bytes,
                               const dn_parallel *parallel, dn_error *err)
{
   dn__frame f;
   dn__skin_job job;
   size_t s, floats, need = dn_scratch_size(rig, dn__workers(parallel));
   DN_ASSERT(pose && pose->palette && scratch && ((uintptr_t)scratch & 63) == 0);
   if (scratch_bytes < need)
      return dn__fail_sizes(err, DN_TOO_SMALL, "frame", SIZE_MAX, "scratch: ", scratch_bytes,
                            " bytes given, needed ", need, NULL);
   f = dn__frame_of(rig, scratch, dn__workers(parallel));
   floats = dn__matrix_floats(pose->matrix);
   f.state[0] = 0;
   f.state[1] = 1;
   f.state[2] = !pose->skinned && rig->skinning == DN_LBS;
   for (s = 0; s < rig->view.joints; s++) {
      dn__load_matrix(pose->palette + floats * s, pose->matrix, f.palette + 12 * s);
      f.state[1] &= (uint32_t)dn__finite12(f.palette + 12 * s);
      if (!f.wide) continue;
      memcpy(f.wide + 16 * s, f.palette + 12 * s, 12 * sizeof(float));
      memset(f.wide + 16 * s + 12, 0, 4 * sizeof(float));
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
   for (i = begin; i < end; i++) memcpy(f->coarse + 3 * i, f->skinned + 3 * (size_t)view->first_vertex[i], 12);
   if (!j->r->model) return;
   if (f->state[2]) /* the same sums again, not yet rounded */
      dn__framed_lbs_run(j->r->kernel, view->rest, view->skin_joint, view->skin_weight, view->influences, view->first_vertex,
                         f->palette, f->root, begin, end, f->framed);
   else
      for (i = begin; i < end; i++) {
         double p[3];
         for (k = 0; k < 3; k++) p[k] = (double)f->coarse[3 * i + k];
         dn__unrotate(f->root, p, f->framed + 3 * i);
      }
}
/* columns of rows begin..end, `stride` apart: all of them, or the live ones */
static void dn__rows_write(const dn_rig *r, const dn__frame *f, int all, size_t begin, size_t end, float *rows, size_t stride)
{
   const dn_rig_view *v = &r->view;
   const dn__stage *m = &r->model->stage[0];
   size_t k, joints = r->model->info.joints;
   for (k = 0; k < m->feature_count; k++) {
      switch (m->features[k]) {
      case DN_POSITION: dn__rows_position(f->framed, begin, end, rows, stride); rows += 3; break;
      case DN_RELATIVE:
         dn__rows_relative_run(r->kernel, v->rest, v->skin_joint, v->skin_weight, v->influences, v->first_vertex, f->seen,
                               begin, end, rows, stride);
         rows += 3;
         break;
      case DN_NORMAL: dn__rows_normal(f->normals, begin, end, rows, stride); rows += 3; break;
      case DN_GEODESIC:
         if (!all && m->bound_width) break;
         dn__rows_geodesic(v->geodesic, joints, begin, end, rows, stride);
         rows += joints;
         break;
      case DN_DISTANCE:
         dn__rows_distance_run(r->kernel, f->framed, f->posed, joints, begin, end, rows, stride);
         rows += joints;
         break;
      case DN_FIT: /* garments only */
      default: break;
      }
   }
}
static void dn__rows_range(void *job, size_t begin, size_t end, unsigned worker)
{
   enum { FEW = 32 }; /* nodes whose rows stay in the first-level cache until they are normalised */
   const dn__rows_job *j = (const dn__rows_job *)job;
   const dn__frame *f = j->f;
   const dn__stage *m = &j->r->model->stage[0];
   size_t width = dn__live_width(m), few;
   (void)worker;
   for (; begin < end; begin = few) {
      few = dn__min(end, begin + FEW);
      dn__normals_fine_run(j->r->kernel, f->framed, j->r->view.triangle, j->r->corner_first, j->r->corner_tri, begin, few,
                           f->normals);
      dn__rows_write(j->r, f, 0, begin, few, f->rows, width);
      if (m->input_mean)
         dn__normalise_run(j->r->kernel, m->input_mean, m->input_scale, m->input_rest, width, f->rows, begin, few);
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
static void dn__keep_finite(const dn__frame *f, size_t begin, size_t end) /* the worst case is always the skinned mesh */
{
   size_t i, k, stop;
   for (; begin < end; begin = stop) {
      uint32_t fallen = 0;
      stop = dn__min(end, begin + DN__TALLY);
      for (i = begin; i < stop; i++) {
         float *d = f->displacement + 3 * i;
         int good = 1;
         for (k = 0; k < 3; k++) good &= dn__finite(d[k]) & dn__finite(f->coarse[3 * i + k]);
         if (good) continue;
         fallen++;
         d[0] = d[1] = d[2] = 0.0f;
      }
      f->tally[begin / DN__TALLY].fallen = fallen;
   }
}
static void dn__count_fallen(const dn__frame *f, size_t nodes)
{
   size_t i;
   for (i = 0; i * DN__TALLY < nodes; i++) f->state[0] += f->tally[i].fallen;
}
/* the network's output, in its units and frame, to displacements in model space */
typedef struct dn__scale_job { const dn__stage *stage; const float *root; float *rows; const dn__frame *f; } dn__scale_job;
static void dn__displace_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__scale_job *j = (const dn__scale_job *)job;
   const dn__stage *m = j->stage;
   size_t i, k;
   (void)worker;
   for (i = begin; i < end; i++) {
      float *d = j->rows + 3 * i;
      for (k = 0; k < 3; k++) d[k] = d[k] * m->output_std[k] + m->output_mean[k];
      dn__rotate(j->root, d, d);
   }
   if (j->f) dn__keep_finite(j->f, begin, end);
}
/* f: the rig's frame whose displacement that is; NULL: a garment's, which looks at it later */
static void dn__displace(const dn__stage *stage, const float root[9], float *displacement, size_t nodes, const dn__frame *f,
                         const dn_parallel *parallel)
{
   dn__scale_job job;
   job.stage = stage;
   job.root = root;
   job.rows = displacement;
   job.f = f;
   dn__for(parallel, nodes, DN__TALLY, dn__displace_range, &job);
   if (f) dn__count_fallen(f, nodes);
}
DN_API void dn_stage_network(const dn_rig *rig, void *scratch, const dn_parallel *parallel, const dn_probe *probe)
{
   dn__frame f = dn__frame_of(rig, scratch, dn__workers(parallel));
   dn__run run;
   size_t nodes = rig->view.nodes;
   if (!rig->model) {
      memset(f.displacement, 0, 3 * nodes * sizeof *f.displacement);
      return;
   }
   run.m = rig->model;
   run.stage = &rig->model->stage[0];
   run.g = &rig->view.graph;
   run.n = &f.net;
   run.start = rig->start;
   run.par = parallel;
   run.probe = probe;
   run.found = NULL;
   dn__run_network(&run, f.rows, f.displacement);
   dn__displace(run.stage, f.root, f.displacement, nodes, &f, parallel);
}

/* --- stage 4: out to the caller */
typedef struct dn__output_job { const dn_rig *r; const dn__frame *f; const dn_pose *pose; dn_output *out; float strength; } dn__output_job;
static float dn__unit_clamp(float x) { return x > 1.0f ? 1.0f : x > 0.0f ? x : 0.0f; } /* NaN: 0 */
static float dn__amount(const dn__output_job *j, size_t v)
{
   return j->pose->mask ? j->strength * dn__unit_clamp(j->pose->mask[v]) : j->strength;
}
static void dn__shift(const dn__output_job *j, size_t v, size_t node, float shift[3])
{
   const float *d = j->f->displacement + 3 * node;
   float amount = dn__amount(j, v);
   size_t k;
   for (k = 0; k < 3; k++) shift[k] = amount * d[k];
}
/* vertices begin..end refined in place, and their box; NaN is in no box */
static void dn__refine(const dn__output_job *j, size_t begin, size_t end, dn__tally *t)
{
   const uint32_t *node = j->r->view.node_of_vertex;
   float low[3] = { 3.402823466e38f, 3.402823466e38f, 3.402823466e38f }, high[3] = { -3.402823466e38f, -3.402823466e38f, -3.402823466e38f };
   float *skinned = j->f->skinned;
   size_t v, k;
   for (v = begin; v < end; v++) {
      float shift[3], *p = skinned + 3 * v;
      dn__shift(j, v, node[v], shift);
      for (k = 0; k < 3; k++) {
         float x = p[k] + shift[k];
         p[k] = x;
         low[k] = x < low[k] ? x : low[k];
         high[k] = x > high[k] ? x : high[k];
      }
   }
   memcpy(t->low, low, sizeof low);
   memcpy(t->high, high, sizeof high);
}
static void dn__rest_delta(const dn__output_job *j, size_t v) /* M rest_delta = displacement, M the vertex's blended matrix */
{
   const dn_rig_view *view = &j->r->view;
   const uint32_t *joint = view->skin_joint + v * view->influences;
   const float *weight = view->skin_weight + v * view->influences;
   float m[12], shift[3], back[3];
   dn__shift(j, v, view->node_of_vertex[v], shift);
   if (j->r->skinning == DN_DQS) dn__dqs_blend(joint, weight, view->influences, j->f->dual, m);
   else dn__lbs_blend(joint, weight, view->influences, j->f->palette, m);
   dn__unskin(m, shift, back);
   memcpy(dn__strided(j->out->rest_delta, dn__stride(j->out->rest_delta_stride, 12), v), back, 12);
}
static void dn__strided_copy(float *to, size_t stride, const float *from, size_t begin, size_t end)
{
   size_t v;
   stride = dn__stride(stride, 12);
   for (v = begin; v < end; v++) memcpy(dn__strided(to, stride, v), from + 3 * v, 12);
}
static void dn__output_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__output_job *j = (const dn__output_job *)job;
   const dn_rig_view *view = &j->r->view;
   const dn_output *o = j->out;
   size_t v, stop;
   (void)worker;
   for (; begin < end; begin = stop) {
      stop = dn__min(end, begin + DN__TALLY);
      dn__refine(j, begin, stop, j->f->tally + begin / DN__TALLY);
      if (o->positions) dn__strided_copy(o->positions, o->position_stride, j->f->skinned, begin, stop);
      for (v = begin; o->displacement && v < stop; v++) {
         float shift[3];
         dn__shift(j, v, view->node_of_vertex[v], shift);
         memcpy(dn__strided(o->displacement, dn__stride(o->displacement_stride, 12), v), shift, 12);
      }
      for (v = begin; o->rest_delta && v < stop; v++) dn__rest_delta(j, v);
      /* Nodes of these numbers, there are no more than vertices, for the normals. Their vertices may carry different
         masks: the first one speaks for a node */
      for (v = begin; o->normals && v < dn__min(stop, view->nodes); v++) {
         float *to = j->f->refined + 3 * v;
         dn__shift(j, view->first_vertex[v], v, to);
         to[0] += j->f->coarse[3 * v], to[1] += j->f->coarse[3 * v + 1], to[2] += j->f->coarse[3 * v + 2];
      }
   }
}
static void dn__node_normals_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__output_job *j = (const dn__output_job *)job;
   (void)worker;
   dn__normals_run(j->r->kernel, j->f->refined, j->r->view.triangle, j->r->corner_first, j->r->corner_tri, begin, end,
                   j->f->normals);
}
static void dn__normals_out_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__output_job *j = (const dn__output_job *)job;
   const uint32_t *node = j->r->view.node_of_vertex;
   const float *normals = j->f->normals;
   float *to = j->out->normals;
   size_t v, stride = dn__stride(j->out->normal_stride, 12);
   (void)worker;
   for (v = begin; v < end; v++) memcpy(dn__strided(to, stride, v), normals + 3 * (size_t)node[v], 12);
}
static dn_result dn__frame_result(const dn_rig *rig, const dn__frame *f, dn_error *err)
{
   if (f->state[0] == 0 && f->state[1]) return DN_OK;
   return dn__fail_sizes(err, DN_NOT_FINITE, "frame", SIZE_MAX, f->state[1] ? "nodes plainly skinned: "
                         : "the palette is not finite; nodes plainly skinned: ", f->state[0], " of ", rig->view.nodes, NULL);
}
DN_API dn_result dn_stage_output(const dn_rig *rig, const dn_pose *pose, dn_output *out, void *scratch,
                                 const dn_parallel *parallel, dn_error *err)
{
   dn__frame f = dn__frame_of(rig, scratch, dn__workers(parallel));
   dn__output_job job;
   size_t i, k;
   DN_ASSERT(out && pose);
   job.r = rig;
   job.f = &f;
   job.pose = pose;
   job.out = out;
   job.strength = dn__unit_clamp(pose->strength);
   dn__for(parallel, rig->view.vertices, DN__TALLY, dn__output_range, &job);
   memcpy(out->bounds_min, f.tally[0].low, sizeof out->bounds_min);
   memcpy(out->bounds_max, f.tally[0].high, sizeof out->bounds_max);
   for (i = 1; i * DN__TALLY < rig->view.vertices; i++)
      for (k = 0; k < 3; k++) {
         if (f.tally[i].low[k] < out->bounds_min[k]) out->bounds_min[k] = f.tally[i].low[k];
         if (f.tally[i].high[k] > out->bounds_max[k]) out->bounds_max[k] = f.tally[i].high[k];
      }
   if (out->normals) {
      dn__for(parallel, rig->view.nodes, 512, dn__node_normals_range, &job);
      dn__for(parallel, rig->view.vertices, 1024, dn__normals_out_range, &job);
   }
   out->fallback_nodes = f.state[0];
   return dn__frame_result(rig, &f, err);
}

DN_API dn_result dn_deform(const dn_rig *rig, const dn_pose *pose, dn_output *out, void *scratch,
                           size_t scratch_bytes, const dn_parallel *parallel, dn_error *err)
{
   dn_result r = dn_stage_skin(rig, pose, scratch, scratch_bytes, parallel, err);
   if (r != DN_OK) return r;
   dn_stage_rows(rig, scratch, parallel);
   dn_stage_network(rig, scratch, parallel, NULL);
   return dn_stage_output(rig, pose, out, scratch, parallel, err);
}
/* the workers do not move what lies before the network's buffers, so any count finds these */
DN_API void dn_rows(const dn_rig *rig, const void *scratch, float *rows)
{
   dn__frame f = dn__frame_of(rig, (void *)(uintptr_t)scratch, 1);
   DN_ASSERT(rig->model);
   dn__rows_write(rig, &f, 1, 0, rig->view.nodes, rows, rig->model->info.row_width);
}
DN_API const float *dn_scratch_coarse(const dn_rig *rig, const void *scratch) { return dn__frame_of(rig, (void *)(uintptr_t)scratch, 1).coarse; }
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
   dn_result result;
   if (dn__step(b, "rest pooling", 0.0f)) return dn__cancelled(b);
   for (s = 0; s < b->joints; s++)
      for (k = 0; k < 12; k++) identity[12 * s + k] = k % 5 == 0 ? 1.0f : 0.0f;
   memset(&pose, 0, sizeof pose);
   pose.palette = identity;
   if ((result = dn_stage_skin(r, &pose, scratch, bytes, par, b->err)) != DN_OK) return result;
   dn_stage_rows(r, scratch, par);
   f = dn__frame_of(r, scratch, dn__workers(par));
   run.m = r->model;
   run.stage = &r->model->stage[0];
   run.g = &r->view.graph;
   run.n = &f.net;
   run.start = r->start;
   run.par = par;
   run.probe = NULL;
   run.found = &r->clusters;
   dn__run_network(&run, f.rows, NULL);
   r->coarse_bandwidth = dn__graph_bandwidth(&r->clusters.graph);
   r->has_clusters = 1;
   return DN_OK;
}

/* ===================================================================================== >>budget
   in       a rig, poses, corrections of other frames        out   positions, as >>frame; coarse meshes
   touches  what the caller gives: no allocation, no I/O, no statics
   read     dn_evaluate, dn_track_put, dn_carry; then dn__thin_round, dn__foot_find and dn_coarse_init */

/* the same character without its network: scratch and stages of a frame that does not run it */
static dn_rig dn__plain_rig(const dn_rig *r)
{
   dn_rig plain = *r;
   plain.model = NULL;
   plain.has_clusters = 0;
   return plain;
}
/* R_i: the rotation of node i's blended matrix */
static void dn__node_rotation(const dn_rig *r, const dn__frame *f, size_t node, float rotation[9])
{
   size_t v = r->view.first_vertex[node], I = r->view.influences;
   const uint32_t *joint = r->view.skin_joint + v * I;
   const float *weight = r->view.skin_weight + v * I;
   float m[12], part[9];
   if (r->skinning == DN_DQS) dn__dqs_blend(joint, weight, I, f->dual, m);
   else dn__lbs_blend(joint, weight, I, f->palette, m);
   dn__part3x3(m, part);
   dn_orthonormalise(part, rotation);
}

typedef struct dn__keep_job { const dn_rig *r; const dn__frame *f; float *correction; } dn__keep_job;
static void dn__keep_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__keep_job *j = (const dn__keep_job *)job;
   size_t i, k;
   (void)worker;
   for (i = begin; i < end; i++) { /* c_i = R_i^T Delta_i */
      const float *d = j->f->displacement + 3 * i;
      float r[9], *c = j->correction + 3 * i;
      dn__node_rotation(j->r, j->f, i, r);
      for (k = 0; k < 3; k++) c[k] = r[k] * d[0] + r[3 + k] * d[1] + r[6 + k] * d[2];
   }
}
DN_API void dn_stage_keep(const dn_rig *rig, const void *scratch, float *correction, const dn_parallel *parallel)
{
   dn__frame f = dn__frame_of(rig, (void *)(uintptr_t)scratch, dn__workers(parallel));
   dn__keep_job job;
   DN_ASSERT(correction);
   job.r = rig;
   job.f = &f;
   job.correction = correction;
   dn__for(parallel, rig->view.nodes, 1024, dn__keep_range, &job);
}
DN_API dn_result dn_evaluate(const dn_rig *rig, const dn_pose *pose, float *correction, void *scratch, size_t scratch_bytes,
                             const dn_parallel *parallel, dn_error *err)
{
   dn__frame f;
   dn_result r = dn_stage_skin(rig, pose, scratch, scratch_bytes, parallel, err);
   if (r != DN_OK) return r;
   dn_stage_rows(rig, scratch, parallel);
   dn_stage_network(rig, scratch, parallel, NULL);
   dn_stage_keep(rig, scratch, correction, parallel);
   f = dn__frame_of(rig, scratch, dn__workers(parallel));
   return dn__frame_result(rig, &f, err);
}

/* --- the track */
static void dn__track_layout(dn_track *t, size_t nodes, dn__arena *a)
{
   t->nodes = nodes;
   t->from = (float *)dn__take(a, dn__mul(nodes, 3), sizeof(float));
   t->to = (float *)dn__take(a, dn__mul(nodes, 3), sizeof(float));
   t->last = (float *)dn__take(a, dn__mul(nodes, 3), sizeof(float));
}
DN_API size_t dn_track_size(size_t nodes)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn_track t;
   dn__track_layout(&t, nodes, &a);
   return dn__gauge(&a);
}
DN_API void dn_track_init(dn_track *t, size_t nodes, void *memory)
{
   dn__arena a = dn__arena_of(memory, SIZE_MAX);
   DN_ASSERT(t && memory && ((uintptr_t)memory & 63) == 0);
   memset(t, 0, sizeof *t);
   dn__track_layout(t, nodes, &a);
}
/* how far the glide is; exactly 1 at its end, so that the end is shown to the bit */
static float dn__track_place(const dn_track *t) { return t->at < t->span ? t->at / t->span : 1.0f; }
static float dn__track_value(const dn_track *t, float place, size_t i)
{
   return place < 1.0f ? t->from[i] + place * (t->to[i] - t->from[i]) : t->to[i];
}
DN_API void dn_track_put(dn_track *t, const float *correction, float span, float lead)
{
   float place = dn__track_place(t), past = t->filled ? dn__unit_clamp(lead) : 0.0f;
   size_t i;
   DN_ASSERT(t && correction);
   for (i = 0; i < 3 * t->nodes; i++) {
      float now = correction[i];
      t->from[i] = t->filled ? dn__track_value(t, place, i) : now;
      t->to[i] = past > 0.0f ? now + past * (now - t->last[i]) : now;
      t->last[i] = now;
   }
   t->span = span > 0.0f ? span : 0.0f;
   t->at = 0.0f;
   t->filled = 1;
}
DN_API void dn_track_advance(dn_track *t, float step)
{
   t->at += step;
   if (!(t->at < t->span)) t->at = t->span; /* waits there, however long; NaN too */
}

/* --- a frame without the network */
DN_API size_t dn_carry_scratch(const dn_rig *rig, unsigned workers)
{
   dn_rig plain = dn__plain_rig(rig);
   return dn_scratch_size(&plain, workers);
}
typedef struct dn__carry_job { const dn_rig *r; const dn__frame *f; const dn_track *track; float place; } dn__carry_job;
static void dn__carry_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__carry_job *j = (const dn__carry_job *)job;
   size_t i, k;
   (void)worker;
   for (i = begin; i < end; i++) { /* Delta_i = R_i c_i */
      float r[9], c[3];
      for (k = 0; k < 3; k++) c[k] = dn__track_value(j->track, j->place, 3 * i + k);
      dn__node_rotation(j->r, j->f, i, r);
      dn__rotate(r, c, j->f->displacement + 3 * i);
   }
   dn__keep_finite(j->f, begin, end);
}
DN_API dn_result dn_carry(const dn_rig *rig, const dn_pose *pose, const dn_track *track, dn_output *out, void *scratch,
                          size_t scratch_bytes, const dn_parallel *parallel, dn_error *err)
{
   dn_rig plain = dn__plain_rig(rig);
   dn__frame f;
   dn_result r = dn_stage_skin(&plain, pose, scratch, scratch_bytes, parallel, err);
   DN_ASSERT(track && track->nodes == rig->view.nodes);
   if (r != DN_OK) return r;
   dn_stage_rows(&plain, scratch, parallel);
   f = dn__frame_of(&plain, scratch, dn__workers(parallel));
   if (!track->filled) memset(f.displacement, 0, 3 * track->nodes * sizeof *f.displacement);
   else {
      dn__carry_job job;
      job.r = &plain;
      job.f = &f;
      job.track = track;
      job.place = dn__track_place(track);
      dn__for(parallel, track->nodes, DN__TALLY, dn__carry_range, &job);
      dn__count_fallen(&f, track->nodes);
   }
   return dn_stage_output(&plain, pose, out, scratch, parallel, err);
}

static const char dn__where_coarse[] = "coarse";
/* --- a thinner mesh for the network. In rounds: every node names the neighbour it would best be drawn into, and what that
   costs; the cheapest of them go, of which no two are near, so that what was checked for one holds when all have gone. */
typedef struct dn__thin {
   const dn_rig_view *v;
   dn_graph g;                          /* of the triangles that are left; nodes keep the full rig's numbers */
   size_t triangles;
   uint32_t *triangle;                  /* (T,3) */
   uint32_t *first, *next;              /* (N+1), (6T) */
   uint32_t *corner_first, *corner_tri; /* (N+1), (3T) */
   uint32_t *owner;                     /* (N) itself, or the node it was drawn into */
   uint32_t *target;                    /* (N) where it would go in this round */
   uint64_t *order, *spare;             /* (N) cost, node */
   unsigned char *busy;                 /* (N) near one that goes in this round */
   float *normal;                       /* (N,3) of the full mesh at rest */
   uint32_t *coarse;                    /* (N) kept nodes' numbers on the coarse mesh */
   void *work;
} dn__thin;
enum { DN__THIN_RING = 24 }; /* nodes with more neighbours stay: nothing below is more than linear in a hub */

static void dn__thin_layout(dn__thin *t, size_t nodes, size_t triangles, dn__arena *a)
{
   t->triangle = (uint32_t *)dn__take(a, dn__mul(triangles, 3), sizeof(uint32_t));
   t->first = (uint32_t *)dn__take(a, dn__add(nodes, 1), sizeof(uint32_t));
   t->next = (uint32_t *)dn__take(a, dn__mul(triangles, 6), sizeof(uint32_t));
   t->corner_first = (uint32_t *)dn__take(a, dn__add(nodes, 1), sizeof(uint32_t));
   t->corner_tri = (uint32_t *)dn__take(a, dn__mul(triangles, 3), sizeof(uint32_t));
   t->owner = (uint32_t *)dn__take(a, nodes, sizeof(uint32_t));
   t->target = (uint32_t *)dn__take(a, nodes, sizeof(uint32_t));
   t->order = (uint64_t *)dn__take(a, nodes, sizeof(uint64_t));
   t->spare = (uint64_t *)dn__take(a, nodes, sizeof(uint64_t));
   t->busy = (unsigned char *)dn__take(a, nodes, 1);
   t->normal = (float *)dn__take(a, dn__mul(nodes, 3), sizeof(float));
   t->coarse = (uint32_t *)dn__take(a, nodes, sizeof(uint32_t));
   t->work = dn__take(a, dn_graph_scratch(nodes, triangles), 1);
}
static void dn__minus(const float *a, const float *b, double out[3])
{
   int k;
   for (k = 0; k < 3; k++) out[k] = (double)a[k] - (double)b[k];
}
/* half the sum over joints of |w_a - w_b|: 0 the same, 1 nothing in common; rows of view.skin */
static double dn__skin_gap(const dn_rig_view *v, size_t a, size_t b)
{
   size_t I = v->influences, i;
   const uint32_t *ja = v->skin_joint + I * (size_t)v->first_vertex[a], *jb = v->skin_joint + I * (size_t)v->first_vertex[b];
   const float *wa = v->skin_weight + I * (size_t)v->first_vertex[a], *wb = v->skin_weight + I * (size_t)v->first_vertex[b];
   double shared = 0.0;
   for (i = 0; i < I; i++) {
      double w = dn__weight_of(jb, wb, I, ja[i]);
      if (wa[i] > 0.0f) shared += w < (double)wa[i] ? w : (double)wa[i]; /* sum of min; both rows sum to one */
   }
   return shared < 1.0 ? 1.0 - shared : 0.0;
}
static int dn__thin_adjacent(const dn_graph *g, uint32_t a, uint32_t b)
{
   uint32_t low, high;
   if (g->first[a + 1] - g->first[a] > g->first[b + 1] - g->first[b]) low = a, a = b, b = low;
   low = g->first[a], high = g->first[a + 1];
   while (low < high) {
      uint32_t middle = low + (high - low) / 2;
      if (g->next[middle] < b) low = middle + 1;
      else high = middle;
   }
   return low < g->first[a + 1] && g->next[low] == b;
}
/* the corners of triangle e that follow u */
static void dn__thin_others(const dn__thin *t, size_t e, uint32_t u, uint32_t *a, uint32_t *b)
{
   const uint32_t *q = t->triangle + 3 * e;
   int at = q[0] == u ? 0 : q[1] == u ? 1 : 2;
   *a = q[(at + 1) % 3];
   *b = q[(at + 2) % 3];
}
/* What drawing u into its neighbour v costs, or a negative number when it must not be: the surface around would cease to
   be one, or a triangle turn over.

   cost     flat^2 + length^2 (4 gap^2 + 0.1): flat is how far u lies off the triangles (and, on a border, the line) that
            then close the hole, gap the difference of skin weights. In metres, so that fine parts give up more of their
            nodes than coarse ones: costs relative to the edges around lost five times as much of the correction
   limit    negative, or a cost from which on the answer does not matter */
static double dn__thin_cost(const dn__thin *t, uint32_t u, uint32_t v, const uint32_t *ring, const unsigned char *uses,
                            size_t count, int border, double limit)
{
   const float *rest = t->v->rest, *pu = rest + 3 * (size_t)u, *pv = rest + 3 * (size_t)v;
   double away[3], flat = 0.0, length, gap, cost;
   size_t i, common = 0, want = border ? 1 : 2;
   uint32_t e;
   dn__minus(pu, pv, away);
   length = dn__dot3(away, away);
   if (limit >= 0.0 && length * 0.1 >= limit) return -1.0;
   for (i = 0; i < count; i++) {
      if (ring[i] == v) {
         if (uses[i] != want) return -1.0;
      } else common += (size_t)dn__thin_adjacent(&t->g, ring[i], v);
   }
   if (common != want) return -1.0;
   gap = dn__skin_gap(t->v, u, v);
   cost = length * (4.0 * gap * gap + 0.1);
   if (limit >= 0.0 && cost >= limit) return -1.0;
   for (e = t->corner_first[u]; e < t->corner_first[u + 1]; e++) {
      double x[3], y[3], before[3], after[3], square, was;
      uint32_t a, b, f;
      dn__thin_others(t, t->corner_tri[e], u, &a, &b);
      if (a == v || b == v) continue;
      if (count == 3 && !border) { /* v, a, b: the lid of a tetrahedron must not be there already */
         if (t->corner_first[a + 1] - t->corner_first[a] > DN__THIN_RING) return -1.0;
         for (f = t->corner_first[a]; f < t->corner_first[a + 1]; f++) {
            uint32_t c, d;
            dn__thin_others(t, t->corner_tri[f], a, &c, &d);
            if ((c == v && d == b) || (c == b && d == v)) return -1.0;
         }
      }
      dn__minus(rest + 3 * (size_t)a, pu, x), dn__minus(rest + 3 * (size_t)b, pu, y);
      dn__cross3(x, y, before);
      dn__minus(rest + 3 * (size_t)a, pv, x), dn__minus(rest + 3 * (size_t)b, pv, y);
      dn__cross3(x, y, after);
      was = dn__dot3(before, before);
      square = dn__dot3(after, after);
      if (!(square > 1e-6 * was)) return -1.0;
      if (was > 0.0 && dn__dot3(before, after) < 0.2 * DN_SQRT(was * square)) return -1.0;
      was = dn__dot3(away, after);
      if (was * was > flat * square) flat = was * was / square;
   }
   for (i = 0; border && i < count; i++)
      if (uses[i] == 1 && ring[i] != v) { /* the border's other end */
         double line[3], along;
         dn__minus(rest + 3 * (size_t)ring[i], pv, line);
         along = dn__dot3(line, away);
         along = length - along * along / (dn__dot3(line, line) + 1e-30);
         if (along > flat) flat = along;
      }
   return cost + flat;
}
/* where u would go, and for how much; negative: nowhere */
static double dn__thin_choose(const dn__thin *t, uint32_t u, uint32_t *target)
{
   const uint32_t *ring = t->g.next + t->g.first[u];
   size_t count = t->g.first[u + 1] - t->g.first[u], i, open = 0;
   unsigned char uses[DN__THIN_RING];
   double best = -1.0;
   uint32_t e;
   if (count == 0 || count > DN__THIN_RING || t->corner_first[u + 1] - t->corner_first[u] > DN__THIN_RING) return -1.0;
   memset(uses, 0, sizeof uses);
   for (e = t->corner_first[u]; e < t->corner_first[u + 1]; e++) {
      uint32_t a, b;
      dn__thin_others(t, t->corner_tri[e], u, &a, &b);
      for (i = 0; i < count; i++) uses[i] = (unsigned char)(uses[i] + (ring[i] == a || ring[i] == b));
   }
   for (i = 0; i < count; i++) {
      if (uses[i] > 2) return -1.0; /* three sheets meet */
      open += uses[i] == 1;
   }
   if ((open != 0 && open != 2) || count - open < (open ? 1u : 3u)) return -1.0; /* a fan and no more; an ear's tip stays */
   for (i = 0; i < count; i++) {
      double cost = dn__thin_cost(t, u, ring[i], ring, uses, count, open != 0, best);
      if (cost >= 0.0 && (best < 0.0 || cost < best)) best = cost, *target = ring[i];
   }
   return best;
}
static void dn__thin_connect(dn__thin *t)
{
   (void)dn__graph_build(t->triangle, t->triangles, t->v->nodes, t->first, t->next, &t->g, t->work, NULL);
   dn__corners_build(t->triangle, t->triangles, t->v->nodes, t->corner_first, t->corner_tri);
}
/* one round; returns how many went */
static size_t dn__thin_round(dn__thin *t, size_t most)
{
   size_t i, k, n = 0, gone = 0, kept = 0, N = t->v->nodes;
   uint64_t *order;
   for (i = 0; i < N; i++) {
      double cost = t->owner[i] == (uint32_t)i ? dn__thin_choose(t, (uint32_t)i, &t->target[i]) : -1.0;
      float key = (float)cost;
      uint32_t bits;
      if (!(cost >= 0.0) || !dn__finite(key)) continue;
      memcpy(&bits, &key, 4); /* not negative: its bits rise with it */
      t->order[n++] = (uint64_t)bits << 32 | i;
   }
   order = dn__sort_edges(t->order, t->spare, n);
   memset(t->busy, 0, N);
   for (k = 0; k < n && gone < most; k++) {
      uint32_t u = (uint32_t)(order[k] & 0xffffffffu), e;
      int clear = !t->busy[u];
      for (e = t->first[u]; e < t->first[u + 1]; e++) clear &= !t->busy[t->next[e]];
      if (!clear) continue;
      t->busy[u] = 1;
      for (e = t->first[u]; e < t->first[u + 1]; e++) t->busy[t->next[e]] = 1;
      t->owner[u] = t->target[u];
      gone++;
   }
   for (i = 0; i < t->triangles; i++) {
      uint32_t q[3];
      for (k = 0; k < 3; k++) q[k] = t->owner[t->triangle[3 * i + k]]; /* who takes its place stays in this round */
      if (q[0] == q[1] || q[1] == q[2] || q[2] == q[0]) continue;
      memcpy(t->triangle + 3 * kept++, q, sizeof q);
   }
   t->triangles = kept;
   dn__thin_connect(t);
   return gone;
}

/* --- the way back: each node of the full mesh from the corners of the coarse triangle closest to it, sought around the node
   that it was drawn into */
typedef struct dn__foot { double score; uint32_t node[3]; float weight[3]; } dn__foot;
/* p: the point as seen from each corner. Its closest place in the triangle as weights of the corners; returns the distance's
   square */
static double dn__foot_weights(double p[3][3], const double normal[3], double extent, double w[3])
{
   double part[3], area = dn__dot3(normal, normal), best = -1.0;
   size_t k, j;
   for (k = 0; k < 3; k++) {
      dn__cross3(p[(k + 1) % 3], p[(k + 2) % 3], part);
      w[k] = dn__dot3(part, normal);
   }
   if (area > 1e-12 * extent * extent && w[0] >= 0.0 && w[1] >= 0.0 && w[2] >= 0.0) { /* the foot of the perpendicular */
      double height = dn__dot3(p[0], normal), sum = w[0] + w[1] + w[2];
      for (k = 0; k < 3; k++) w[k] /= sum;
      return height * height / area;
   }
   for (k = 0; k < 3; k++) { /* else on an edge */
      size_t l = (k + 1) % 3;
      double edge[3], length, along, s, square = 0.0;
      for (j = 0; j < 3; j++) edge[j] = p[k][j] - p[l][j];
      length = dn__dot3(edge, edge);
      along = dn__dot3(p[k], edge);
      s = along > 0.0 ? along < length ? along / length : 1.0 : 0.0;
      for (j = 0; j < 3; j++) square += (p[k][j] - s * edge[j]) * (p[k][j] - s * edge[j]);
      if (best >= 0.0 && !(square < best)) continue;
      best = square;
      w[k] = 1.0 - s, w[l] = s, w[(k + 2) % 3] = 0.0;
   }
   return best;
}
/* best keeps the better of itself and this triangle, whose corners are q. Distance first; what is as near but carried by
   other joints (the other lip) or faces away (a thin part's other side) is not meant */
static void dn__foot_try(const dn__thin *t, uint32_t u, const uint32_t *q, dn__foot *best)
{
   double p[3][3], x[3], y[3], normal[3], w[3], score, gap = 0.0, facing = 0.0, extent;
   size_t k;
   for (k = 0; k < 3; k++) dn__minus(t->v->rest + 3 * (size_t)u, t->v->rest + 3 * (size_t)q[k], p[k]);
   for (k = 0; k < 3; k++) x[k] = p[0][k] - p[1][k], y[k] = p[0][k] - p[2][k];
   dn__cross3(x, y, normal);
   extent = dn__dot3(x, x) > dn__dot3(y, y) ? dn__dot3(x, x) : dn__dot3(y, y);
   score = dn__foot_weights(p, normal, extent, w);
   for (k = 0; k < 3; k++) {
      gap += w[k] * dn__skin_gap(t->v, u, q[k]);
      facing += normal[k] * (double)t->normal[3 * (size_t)u + k];
   }
   score += extent * (0.25 * gap * gap + (facing < 0.0 ? 1.0 : 0.0));
   if (best->score >= 0.0 && !(score < best->score)) return;
   best->score = score;
   for (k = 0; k < 3; k++) best->node[k] = q[k], best->weight[k] = (float)w[k];
}
static void dn__foot_around(const dn__thin *t, uint32_t u, uint32_t centre, dn__foot *best)
{
   uint32_t e;
   if (t->corner_first[centre + 1] - t->corner_first[centre] > DN__THIN_RING) return;
   for (e = t->corner_first[centre]; e < t->corner_first[centre + 1]; e++) dn__foot_try(t, u, t->triangle + 3 * (size_t)t->corner_tri[e], best);
}
static void dn__foot_find(const dn__thin *t, uint32_t u, dn__foot *best)
{
   const float *rest = t->v->rest;
   uint32_t at = t->owner[u], e;
   double closest, away[3];
   int moved = 1;
   memset(best, 0, sizeof *best);
   best->score = -1.0;
   best->node[0] = best->node[1] = best->node[2] = at;
   best->weight[0] = 1.0f;
   dn__minus(rest + 3 * (size_t)u, rest + 3 * (size_t)at, away);
   closest = dn__dot3(away, away);
   while (moved) { /* down to the nearest kept node, along the coarse mesh */
      uint32_t from = at;
      moved = 0;
      if (t->g.first[from + 1] - t->g.first[from] > DN__THIN_RING) break;
      for (e = t->g.first[from]; e < t->g.first[from + 1]; e++) {
         double square;
         dn__minus(rest + 3 * (size_t)u, rest + 3 * (size_t)t->g.next[e], away);
         square = dn__dot3(away, away);
         if (square < closest) closest = square, at = t->g.next[e], moved = 1;
      }
   }
   dn__foot_around(t, u, at, best);
   if (t->g.first[at + 1] - t->g.first[at] > DN__THIN_RING) return;
   for (e = t->g.first[at]; e < t->g.first[at + 1]; e++) dn__foot_around(t, u, t->g.next[e], best);
}

/* --- dn_coarse */
static void dn__coarse_layout(dn_coarse *c, size_t nodes, size_t full, size_t triangles, size_t influences, size_t joints,
                              dn__arena *a)
{
   c->node = (uint32_t *)dn__take(a, nodes, sizeof(uint32_t));
   c->spread_node = (uint32_t *)dn__take(a, dn__mul(full, 3), sizeof(uint32_t));
   c->spread_weight = (float *)dn__take(a, dn__mul(full, 3), sizeof(float));
   c->mesh.positions = (float *)dn__take(a, dn__mul(nodes, 3), sizeof(float));
   c->mesh.indices = dn__take(a, dn__mul(triangles, 3), sizeof(uint32_t));
   c->mesh.skin = (dn_skin_set *)dn__take(a, 1, sizeof(dn_skin_set));
   c->skin_joint = (uint32_t *)dn__take(a, dn__mul(nodes, influences), sizeof(uint32_t));
   c->skin_weight = (float *)dn__take(a, dn__mul(nodes, influences), sizeof(float));
   c->geodesic = joints ? (float *)dn__take(a, dn__mul(nodes, joints), sizeof(float)) : NULL;
}
static size_t dn__coarse_joints(const dn_rig *r) { return r->model && r->view.geodesic ? r->model->info.joints : 0; }
DN_API dn_result dn_coarse_size(const dn_rig *full, size_t *bytes, size_t *scratch, dn_error *err)
{
   dn__arena kept = dn__arena_of(NULL, 0), temp = dn__arena_of(NULL, 0);
   dn_coarse c;
   dn__thin t;
   DN_ASSERT(full && bytes && scratch);
   dn__coarse_layout(&c, full->view.nodes, full->view.nodes, full->view.triangles, full->view.influences,
                     dn__coarse_joints(full), &kept);
   dn__thin_layout(&t, full->view.nodes, full->view.triangles, &temp);
   *bytes = kept.used;
   *scratch = temp.used;
   return *bytes == SIZE_MAX || *scratch == SIZE_MAX ? dn__fail(err, DN_NO_MEMORY, dn__where_coarse, SIZE_MAX, "sizes overflow")
                                                     : DN_OK;
}
static void dn__coarse_fill(dn_coarse *c, const dn_rig *full, dn__thin *t)
{
   const dn_rig_view *v = &full->view;
   size_t i, k, m, I = v->influences, S = dn__coarse_joints(full);
   uint32_t *node = (uint32_t *)c->node, *index = (uint32_t *)(uintptr_t)c->mesh.indices, *joint = (uint32_t *)c->skin_joint;
   uint32_t *spread = (uint32_t *)c->spread_node;
   float *position = (float *)c->mesh.positions, *weight = (float *)c->skin_weight, *geodesic = (float *)c->geodesic;
   float *share = (float *)c->spread_weight;
   dn_skin_set *set = (dn_skin_set *)c->mesh.skin;
   for (i = m = 0; i < v->vertices; i++) { /* by rising first vertex: the order in which bind will meet them */
      uint32_t n = v->node_of_vertex[i];
      if (v->first_vertex[n] == (uint32_t)i && t->owner[n] == n) node[m] = n, t->coarse[n] = (uint32_t)m++;
   }
   for (m = 0; m < c->nodes; m++) {
      size_t from = v->first_vertex[node[m]];
      memcpy(position + 3 * m, v->rest + 3 * (size_t)node[m], 3 * sizeof(float));
      memcpy(joint + I * m, v->skin_joint + I * from, I * sizeof(uint32_t));
      memcpy(weight + I * m, v->skin_weight + I * from, I * sizeof(float));
      if (S) memcpy(geodesic + S * m, v->geodesic + S * (size_t)node[m], S * sizeof(float));
   }
   for (i = 0; i < 3 * t->triangles; i++) index[i] = t->coarse[t->triangle[i]];
   for (i = 0; i < v->nodes; i++) {
      dn__foot foot;
      memset(&foot, 0, sizeof foot);
      if (t->owner[i] == (uint32_t)i) foot.node[0] = foot.node[1] = foot.node[2] = (uint32_t)i, foot.weight[0] = 1.0f;
      else dn__foot_find(t, (uint32_t)i, &foot);
      for (k = 0; k < 3; k++) spread[3 * i + k] = t->coarse[foot.node[k]], share[3 * i + k] = foot.weight[k];
   }
   memset(set, 0, sizeof *set);
   set->influences = I;
   set->joints = joint;
   set->joint_type = DN_U32;
   set->weights = weight;
   set->weight_type = DN_F32;
   c->mesh.vertices = c->nodes;
   c->mesh.triangles = t->triangles;
   c->mesh.index_type = DN_U32;
   c->mesh.skin_sets = 1;
}
DN_API dn_result dn_coarse_init(const dn_rig *full, float share, void *memory, size_t bytes, void *scratch,
                                size_t scratch_bytes, dn_coarse *coarse, dn_error *err)
{
   const dn_rig_view *v = &full->view;
   dn__arena kept = dn__arena_of(NULL, 0), temp = dn__arena_of(scratch, scratch_bytes);
   size_t i, N = v->nodes, wanted, left = N, S = dn__coarse_joints(full);
   dn__thin t;
   DN_ASSERT(full && memory && scratch && coarse && ((uintptr_t)memory & 63) == 0 && ((uintptr_t)scratch & 63) == 0);
   memset(coarse, 0, sizeof *coarse);
   memset(&t, 0, sizeof t);
   if (!(share > 0.0f && share <= 1.0f)) return dn__fail(err, DN_BAD_VALUE, dn__where_coarse, SIZE_MAX, "share: expected above 0, at most 1");
   dn__thin_layout(&t, N, v->triangles, &temp);
   if (temp.used > scratch_bytes)
      return dn__fail_sizes(err, DN_TOO_SMALL, dn__where_coarse, SIZE_MAX, "scratch: ", scratch_bytes, " bytes given, needed ",
                            temp.used, NULL);
   t.v = v;
   t.triangles = v->triangles;
   memcpy(t.triangle, v->triangle, 3 * v->triangles * sizeof(uint32_t));
   for (i = 0; i < N; i++) t.owner[i] = (uint32_t)i;
   dn__thin_connect(&t);
   dn__normals_range(v->rest, v->triangle, t.corner_first, t.corner_tri, 0, N, t.normal);
   wanted = (size_t)((double)share * (double)N + 0.5);
   while (left > wanted) {
      size_t gone = dn__thin_round(&t, dn__min(left - wanted, left / 16 + 1));
      if (gone == 0) break;
      left -= gone;
   }
   for (i = 0; i < N; i++) { /* who has it in the end: the chains of owners, shortened as they are walked */
      uint32_t at = (uint32_t)i, last = at;
      while (t.owner[last] != last) last = t.owner[last];
      while (t.owner[at] != last) {
         uint32_t next = t.owner[at];
         t.owner[at] = last;
         at = next;
      }
   }
   coarse->full = N;
   coarse->nodes = left;
   dn__coarse_layout(coarse, left, N, t.triangles, v->influences, S, &kept);
   if (kept.used > bytes)
      return dn__fail_sizes(err, DN_TOO_SMALL, dn__where_coarse, SIZE_MAX, "memory: ", bytes, " bytes given, needed ", kept.used, NULL);
   coarse->bytes = kept.used;
   kept = dn__arena_of(memory, bytes);
   dn__coarse_layout(coarse, left, N, t.triangles, v->influences, S, &kept);
   dn__coarse_fill(coarse, full, &t);
   return DN_OK;
}
DN_API void dn_coarse_describe(const dn_coarse *coarse, const dn_rig_desc *full, dn_rig_desc *desc)
{
   *desc = *full;
   desc->mesh = coarse->mesh;
   desc->geodesic = coarse->geodesic;
   desc->geodesic_nodes = coarse->geodesic ? coarse->nodes : 0;
}

typedef struct dn__spread_job { const dn_coarse *c; const uint32_t *order; const float *from; float *to; } dn__spread_job;
static void dn__spread_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__spread_job *j = (const dn__spread_job *)job;
   size_t i, k;
   (void)worker;
   for (i = begin; i < end; i++) { /* c_i = sum_k s_ik coarse_k */
      const uint32_t *node = j->c->spread_node + 3 * i;
      const float *w = j->c->spread_weight + 3 * i;
      const float *x = j->from + 3 * (size_t)j->order[node[0]], *y = j->from + 3 * (size_t)j->order[node[1]];
      const float *z = j->from + 3 * (size_t)j->order[node[2]];
      for (k = 0; k < 3; k++) j->to[3 * i + k] = w[0] * x[k] + w[1] * y[k] + w[2] * z[k];
   }
}
DN_API void dn_spread(const dn_coarse *coarse, const dn_rig *rig, const float *correction, float *full, const dn_parallel *parallel)
{
   dn__spread_job job;
   DN_ASSERT(coarse && rig && rig->view.vertices == coarse->nodes && rig->view.nodes == coarse->nodes && correction && full);
   job.c = coarse;
   job.order = rig->view.node_of_vertex;
   job.from = correction;
   job.to = full;
   dn__for(parallel, coarse->full, 4096, dn__spread_range, &job);
}


/* ===================================================================================== >>kit
   in       rest positions, distance matrices, posed meshes, shape files
   out      association, evenly spread nodes, fit factors, signed distances, positions free of collisions, dn_shape
   touches  the memory and scratch passed in, nothing else: no allocation but in dn_shape_load, no statics
   paper    T 4.3-4.4, C 3, 4.1, 5.1; spec sections 4 (factor analysis) and 5 (association)
   read     dn_associate_ref, dn_factor_fit, then dn_surface_distance_ref, dn__collide_one */
enum { DN__KIT_GRAIN = 64 /* points a range of the parallel loop */, DN__GRID_SIDE = 1024, DN__LEAF = 2, DN__DEEP = 32,
       DN__SHAPE_BLOCK = 512 };

static double dn__square_distance(const float *a, const float *b) /* exact to the last bit or two: differences are exact */
{
   double x = (double)a[0] - (double)b[0], y = (double)a[1] - (double)b[1], z = (double)a[2] - (double)b[2];
   return x * x + y * y + z * z;
}

/* --- association. A grid over the body's box; a point looks at its own cell, then at the shell around it, until the
   best is nearer than anything further out can be. */
typedef struct dn__grid {
   double low[3], cell;
   size_t side[3];
   uint32_t *first; /* (cells+1) */
   uint32_t *node;  /* (B) by cell, ascending within one */
} dn__grid;
static size_t dn__grid_cells(size_t nodes) { return dn__add(dn__mul(nodes, 4), 8); }
static void dn__grid_layout(dn__grid *g, size_t nodes, dn__arena *a)
{
   g->first = (uint32_t *)dn__take(a, dn__add(dn__grid_cells(nodes), 1), sizeof(uint32_t));
   g->node = (uint32_t *)dn__take(a, nodes, sizeof(uint32_t));
}
static size_t dn__grid_place(const dn__grid *g, int axis, double offset) /* cell of low + offset, held inside */
{
   double c = offset / g->cell;
   size_t last = g->side[axis] - 1;
   return c > 0.0 ? c < (double)last ? (size_t)c : last : 0;
}
static size_t dn__grid_cell(const dn__grid *g, const float *p)
{
   size_t x = dn__grid_place(g, 0, (double)p[0] - g->low[0]), y = dn__grid_place(g, 1, (double)p[1] - g->low[1]);
   return (dn__grid_place(g, 2, (double)p[2] - g->low[2]) * g->side[1] + y) * g->side[0] + x;
}
static void dn__grid_build(dn__grid *g, const float *p, size_t nodes)
{
   double high[3], longest = 0.0;
   size_t i, cells, sides;
   uint32_t total = 0;
   int k;
   for (k = 0; k < 3; k++) g->low[k] = high[k] = (double)p[k];
   for (i = 1; i < nodes; i++)
      for (k = 0; k < 3; k++) {
         double v = (double)p[3 * i + (size_t)k];
         if (v < g->low[k]) g->low[k] = v;
         if (v > high[k]) high[k] = v;
      }
   for (k = 0; k < 3; k++) longest = high[k] - g->low[k] > longest ? high[k] - g->low[k] : longest;
   g->cell = longest > 0.0 ? longest : 1.0;
   g->side[0] = g->side[1] = g->side[2] = 1;
   for (sides = 2; longest > 0.0 && sides <= DN__GRID_SIDE; sides++) { /* the finest cubes that still fit the memory */
      size_t side[3];
      double cell = longest / (double)sides;
      for (k = 0; k < 3; k++) side[k] = (size_t)((high[k] - g->low[k]) / cell) + 1;
      if (dn__mul(dn__mul(side[0], side[1]), side[2]) > dn__grid_cells(nodes)) break;
      g->cell = cell;
      memcpy(g->side, side, sizeof side);
   }
   cells = g->side[0] * g->side[1] * g->side[2];
   memset(g->first, 0, (cells + 1) * sizeof *g->first);
   for (i = 0; i < nodes; i++) g->first[dn__grid_cell(g, p + 3 * i)]++;
   for (i = 0; i < cells; i++) { /* counts -> row starts */
      uint32_t count = g->first[i];
      g->first[i] = total;
      total += count;
   }
   for (i = 0; i < nodes; i++) g->node[g->first[dn__grid_cell(g, p + 3 * i)]++] = (uint32_t)i;
   for (i = cells; i > 0; i--) g->first[i] = g->first[i - 1]; /* each start had moved to its row's end */
   g->first[0] = 0;
}
typedef struct dn__associate_job { const dn__grid *g; const float *body, *points; uint32_t *nearest; } dn__associate_job;
static void dn__associate_row(const dn__associate_job *j, const float *p, size_t cell, size_t count, double *best, uint32_t *who)
{
   uint32_t e, end = j->g->first[cell + count];
   for (e = j->g->first[cell]; e < end; e++) {
      uint32_t n = j->g->node[e];
      double d = dn__square_distance(p, j->body + 3 * (size_t)n);
      if (d < *best || (d == *best && n < *who)) *best = d, *who = n;
   }
}
static void dn__associate_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__associate_job *j = (const dn__associate_job *)job;
   const dn__grid *g = j->g;
   size_t i;
   (void)worker;
   for (i = begin; i < end; i++) {
      const float *p = j->points + 3 * i;
      size_t home[3], low[3], high[3], r, y, z;
      double at[3], best = -1.0, bound;
      uint32_t who = DN__NONE;
      int k;
      for (k = 0; k < 3; k++) {
         at[k] = (double)p[k] - g->low[k];
         home[k] = dn__grid_place(g, k, at[k]);
      }
      best = dn__square_distance(p, j->body); /* node 0: some finite bound */
      who = 0;
      for (r = 0;; r++) {
         int whole = 1;
         bound = 1e300; /* how near a node outside this block of cells can be */
         for (k = 0; k < 3; k++) {
            double out;
            low[k] = home[k] > r ? home[k] - r : 0;
            high[k] = dn__min(home[k] + r, g->side[k] - 1);
            if (low[k] > 0) whole = 0, out = at[k] - (double)low[k] * g->cell, bound = out < bound ? out : bound;
            if (high[k] + 1 < g->side[k]) whole = 0, out = (double)(high[k] + 1) * g->cell - at[k], bound = out < bound ? out : bound;
         }
         for (z = low[2]; z <= high[2]; z++)
            for (y = low[1]; y <= high[1]; y++) {
               size_t row = (z * g->side[1] + y) * g->side[0];
               if (r == 0 || z + r == home[2] || z == home[2] + r || y + r == home[1] || y == home[1] + r)
                  dn__associate_row(j, p, row + low[0], high[0] - low[0] + 1, &best, &who); /* a row of the shell's sides */
               else {
                  if (home[0] >= r) dn__associate_row(j, p, row + low[0], 1, &best, &who);
                  if (home[0] + r < g->side[0]) dn__associate_row(j, p, row + high[0], 1, &best, &who);
               }
            }
         bound -= 1e-9 * g->cell; /* the rounding of offset / cell */
         if (whole || (bound > 0.0 && best < bound * bound)) break;
      }
      j->nearest[i] = who;
   }
}
DN_API size_t dn_associate_scratch(size_t body_nodes)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn__grid g;
   dn__grid_layout(&g, body_nodes, &a);
   return dn__gauge(&a);
}
DN_API void dn_associate(const float *body, size_t body_nodes, const float *points, size_t count, uint32_t *nearest,
                         void *scratch, const dn_parallel *parallel)
{
   dn__arena a = dn__arena_of(scratch, SIZE_MAX);
   dn__grid g;
   dn__associate_job job;
   DN_ASSERT(body_nodes > 0 && body_nodes < DN__NONE / 4 && scratch);
   dn__grid_layout(&g, body_nodes, &a);
   dn__grid_build(&g, body, body_nodes);
   job.g = &g;
   job.body = body;
   job.points = points;
   job.nearest = nearest;
   dn__for(parallel, count, DN__KIT_GRAIN, dn__associate_range, &job);
}
DN_API void dn_associate_ref(const float *body, size_t body_nodes, const float *points, size_t count, uint32_t *nearest)
{
   size_t i, n;
   DN_ASSERT(body_nodes > 0);
   for (i = 0; i < count; i++) {
      double best = dn__square_distance(points + 3 * i, body);
      nearest[i] = 0;
      for (n = 1; n < body_nodes; n++) {
         double d = dn__square_distance(points + 3 * i, body + 3 * n);
         if (d < best) best = d, nearest[i] = (uint32_t)n; /* lowest index of several: only a nearer one replaces it */
      }
   }
}

/* --- even selection */
DN_API double dn_area(const float *positions, const uint32_t *triangle, size_t triangles)
{
   double area = 0.0;
   size_t t;
   for (t = 0; t < triangles; t++) {
      const float *a = positions + 3 * (size_t)triangle[3 * t], *b = positions + 3 * (size_t)triangle[3 * t + 1];
      const float *c = positions + 3 * (size_t)triangle[3 * t + 2];
      double u[3], v[3], x, y, z;
      int k;
      for (k = 0; k < 3; k++) u[k] = (double)b[k] - (double)a[k], v[k] = (double)c[k] - (double)a[k];
      x = u[1] * v[2] - u[2] * v[1];
      y = u[2] * v[0] - u[0] * v[2];
      z = u[0] * v[1] - u[1] * v[0];
      area += 0.5 * DN_SQRT(x * x + y * y + z * z);
   }
   return area;
}
static void dn__spread_layout(dn__weld_grid *w, size_t nodes, dn__arena *a)
{
   *w = dn__weld_layout(a, nodes); /* its hash grid; tail is not used */
}
DN_API size_t dn_even_selection_scratch(size_t nodes)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn__weld_grid w;
   dn__spread_layout(&w, nodes, &a);
   return dn__gauge(&a);
}
/* by index, each node at least `reach` from those kept before it, until `wanted` are kept; returns how many were */
static size_t dn__spread(const float *positions, size_t nodes, double square, size_t wanted, uint32_t *kept, dn__weld_grid *w)
{
   double cell = DN_SQRT(square) * 1.0001; /* the hair covers the rounding of position / cell */
   size_t n, count = 0;
   memset(w->head, 0xff, (w->mask + 1) * sizeof *w->head);
   for (n = 0; n < nodes && count < wanted; n++) {
      const float *p = positions + 3 * n;
      double home[3], c[3];
      int k, taken = 0;
      size_t bucket;
      if (nodes - n < wanted - count) return count; /* cannot be reached any more */
      for (k = 0; k < 3; k++) home[k] = dn__floor((double)p[k] / cell);
      for (k = 0; k < 27 && !taken; k++) {
         uint32_t m;
         c[0] = home[0] + (double)(k % 3 - 1);
         c[1] = home[1] + (double)(k / 3 % 3 - 1);
         c[2] = home[2] + (double)(k / 9 - 1);
         for (m = w->head[dn__hash3(c) & w->mask]; m != DN__NONE && !taken; m = w->next[m])
            taken = dn__square_distance(p, positions + 3 * (size_t)m) < square;
      }
      if (taken) continue;
      bucket = dn__hash3(home) & w->mask;
      w->next[n] = w->head[bucket];
      w->head[bucket] = (uint32_t)n;
      kept[count++] = (uint32_t)n;
   }
   return count;
}
DN_API dn_result dn_even_selection(const float *positions, size_t nodes, double area, size_t wanted, uint32_t *selection,
                                   unsigned *spacing, void *scratch, dn_error *err)
{
   dn__arena arena = dn__arena_of(scratch, SIZE_MAX);
   dn__weld_grid w;
   unsigned c;
   size_t i;
   DN_ASSERT(nodes < DN__NONE && scratch && selection);
   if (nodes < wanted)
      return dn__fail_sizes(err, DN_BAD_MESH, "even selection", SIZE_MAX, "found ", nodes, " nodes, expected at least the ", wanted, " wanted");
   dn__spread_layout(&w, nodes, &arena);
   for (c = 1; c <= 4096; c++) { /* C 4.1: r = sqrt(A / (C N*)) */
      double square = wanted ? area / ((double)c * (double)wanted) : 0.0;
      if (!(square > 1e-300 && square < 1e300)) break; /* no area: nothing is closer than nothing */
      if (dn__spread(positions, nodes, square, wanted, selection, &w) == wanted) {
         if (spacing) *spacing = c;
         return DN_OK;
      }
   }
   for (i = 0; i < wanted; i++) selection[i] = (uint32_t)i;
   if (spacing) *spacing = 4097;
   return DN_OK;
}

/* --- smoothing */
typedef struct dn__smooth_job { const dn_graph *g; const float *from; float *to; float factor; } dn__smooth_job;
static void dn__smooth_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__smooth_job *j = (const dn__smooth_job *)job;
   size_t i, k;
   (void)worker;
   for (i = begin; i < end; i++) {
      uint32_t e, first = j->g->first[i], last = j->g->first[i + 1];
      const float *p = j->from + 3 * i;
      double sum[3] = { 0.0, 0.0, 0.0 };
      for (e = first; e < last; e++)
         for (k = 0; k < 3; k++) sum[k] += (double)j->from[3 * (size_t)j->g->next[e] + k];
      for (k = 0; k < 3; k++) /* p += factor (mean - p)                                                     C 5.1 */
         j->to[3 * i + k] = first == last ? p[k]
                          : (float)((double)p[k] + (double)j->factor * (sum[k] / (double)(last - first) - (double)p[k]));
   }
}
DN_API void dn_smooth(const dn_graph *g, float *positions, unsigned iterations, float factor, float *scratch,
                      const dn_parallel *parallel)
{
   dn__smooth_job job;
   float *from = positions, *to = scratch, *swap;
   job.g = g;
   job.factor = factor;
   for (; iterations; iterations--) {
      job.from = from;
      job.to = to;
      dn__for(parallel, g->nodes, DN__KIT_GRAIN, dn__smooth_range, &job);
      swap = from, from = to, to = swap;
   }
   if (from != positions) memcpy(positions, from, 3 * g->nodes * sizeof *positions);
}

/* --- factor analysis. Natural logarithm of a normal number: x = m 2^k with m in [1/sqrt 2, sqrt 2), and
   log m = 2 artanh s = 2 (s + s^3/3 + ... ), s = (m - 1) / (m + 1), |s| < 0.172: after s^23 the rest is under 1e-18.
   Within 3e-16 of itself, or 1e-16 where |log x| < 0.3. */
static double dn__log(double x)
{
   uint64_t bits;
   int k, n;
   double m, s, square, sum = 0.0;
   memcpy(&bits, &x, 8);
   k = (int)(bits >> 52 & 2047u) - 1023;
   bits = (bits & 0xfffffffffffffu) | (uint64_t)1023 << 52;
   memcpy(&m, &bits, 8);
   if (m > 1.4142135623730951) m *= 0.5, k++;
   s = (m - 1.0) / (m + 1.0);
   square = s * s;
   for (n = 23; n > 1; n -= 2) sum = (sum + 1.0 / (double)n) * square;
   return (double)k * 1.9082149292705877e-10 + (2.0 * s + 2.0 * s * sum + (double)k * 0.6931471803691238); /* ln 2 in two parts */
}

/* Eigenvalues, falling, and eigenvectors, as rows, of a symmetric matrix a (n,n), which is destroyed: Householder's
   reflections to a tridiagonal matrix, then QR steps with Wilkinson's shift (Golub and Van Loan, 8.3). z (n,n) rows are
   unit vectors; d (n); e, v, w (n) scratch. */
static void dn__eigen(double *a, size_t n, double *d, double *z, double *e, double *v, double *w)
{
   size_t i, j, k, step, high, steps = 60 * n;
   double norm = 0.0;
   for (k = 0; k + 2 < n; k++) { /* H = I - beta v v^T takes column k to (.., alpha, 0, ..); v stays in a's column k */
      double square = 0.0, alpha, beta = 0.0, half = 0.0;
      for (i = k + 1; i < n; i++) v[i] = a[i * n + k], square += v[i] * v[i];
      alpha = v[k + 1] > 0.0 ? -DN_SQRT(square) : DN_SQRT(square);
      if (square - v[k + 1] * v[k + 1] > 0.0) {
         v[k + 1] -= alpha;
         for (square = 0.0, i = k + 1; i < n; i++) square += v[i] * v[i];
         beta = 2.0 / square;
      } else alpha = v[k + 1]; /* nothing to take away */
      d[k] = a[k * n + k];
      e[k] = alpha;
      for (i = k + 1; i < n; i++) {
         double sum = 0.0;
         for (j = k + 1; j < n; j++) sum += a[i * n + j] * v[j];
         w[i] = beta * sum;
         half += 0.5 * beta * w[i] * v[i];
      }
      for (i = k + 1; i < n; i++) w[i] -= half * v[i];
      if (beta > 0.0)
         for (i = k + 1; i < n; i++) /* A = H A H = A - v w^T - w v^T */
            for (j = k + 1; j < n; j++) a[i * n + j] -= v[i] * w[j] + w[i] * v[j];
      for (i = k + 1; i < n; i++) a[i * n + k] = v[i];
      a[k * n + k] = beta;
   }
   if (n > 1) {
      d[n - 2] = a[(n - 2) * n + n - 2];
      e[n - 2] = a[(n - 1) * n + n - 2];
   }
   d[n - 1] = a[n * n - 1];
   memset(z, 0, n * n * sizeof *z); /* Q^T = .. H_1 H_0, built from the last reflection on: row r of z is column r of Q */
   for (i = 0; i < n; i++) z[i * n + i] = 1.0;
   for (k = n; k-- > 0;) {
      double beta = k + 2 < n ? a[k * n + k] : 0.0;
      if (!(beta > 0.0)) continue;
      for (i = k + 1; i < n; i++) {
         double sum = 0.0;
         for (j = k + 1; j < n; j++) sum += z[i * n + j] * a[j * n + k];
         sum *= beta;
         for (j = k + 1; j < n; j++) z[i * n + j] -= sum * a[j * n + k];
      }
   }
   for (i = 0; i < n; i++) norm = DN_FABS(d[i]) > norm ? DN_FABS(d[i]) : norm;
   for (high = n - 1, step = 0; high > 0 && step < steps; step++) {
      size_t low = high;
      double shift, x, y;
      while (low > 0 && DN_FABS(e[low - 1]) > 1e-16 * (DN_FABS(d[low - 1]) + DN_FABS(d[low])) && DN_FABS(e[low - 1]) > 1e-18 * norm) low--;
      if (low == high) { /* an eigenvalue stands alone */
         high--;
         continue;
      }
      x = 0.5 * (d[high - 1] - d[high]);
      y = DN_SQRT(x * x + e[high - 1] * e[high - 1]);
      shift = d[high] - e[high - 1] * e[high - 1] / (x > 0.0 ? x + y : x - y);
      x = d[low] - shift;
      y = e[low];
      for (k = low; k < high; k++) { /* chase the bulge down */
         double r = DN_SQRT(x * x + y * y), c = r > 0.0 ? x / r : 1.0, s = r > 0.0 ? y / r : 0.0, p = d[k], q = d[k + 1], b = e[k];
         double *up = z + k * n, *down = up + n;
         if (k > low) e[k - 1] = r;
         d[k] = c * c * p + 2.0 * c * s * b + s * s * q;
         d[k + 1] = s * s * p - 2.0 * c * s * b + c * c * q;
         e[k] = c * s * (q - p) + (c * c - s * s) * b;
         x = e[k];
         if (k + 1 < high) {
            y = s * e[k + 1];
            e[k + 1] *= c;
         }
         for (j = 0; j < n; j++) {
            double t = up[j];
            up[j] = c * t + s * down[j];
            down[j] = c * down[j] - s * t;
         }
      }
   }
   for (i = 0; i + 1 < n; i++) { /* falling */
      size_t most = i;
      for (j = i + 1; j < n; j++)
         if (d[j] > d[most]) most = j;
      if (most == i) continue;
      { double t = d[i]; d[i] = d[most]; d[most] = t; }
      for (j = 0; j < n; j++) {
         double t = z[i * n + j];
         z[i * n + j] = z[most * n + j];
         z[most * n + j] = t;
      }
   }
}

typedef struct dn__factor { /* a fit's scratch; D rows, P pairs, n factors, m = min(D, P) */
   double *x;                     /* (D,P) centred */
   double *mean, *variance, *psi; /* (D) */
   double *loading;               /* (D,n) */
   double *cov;                   /* (D,D) S when D <= P */
   double *a, *z;                 /* (m,m) the matrix and its eigenvectors in rows */
   double *d, *e, *v, *w;         /* (m) */
} dn__factor;
static void dn__factor_layout(dn__factor *f, size_t rows, size_t pairs, size_t factors, dn__arena *a)
{
   size_t m = dn__min(rows, pairs);
   f->x = (double *)dn__take(a, dn__mul(rows, pairs), sizeof(double));
   f->mean = (double *)dn__take(a, rows, sizeof(double));
   f->variance = (double *)dn__take(a, rows, sizeof(double));
   f->psi = (double *)dn__take(a, rows, sizeof(double));
   f->loading = (double *)dn__take(a, dn__mul(rows, factors), sizeof(double));
   f->cov = (double *)dn__take(a, rows <= pairs ? dn__mul(rows, rows) : 0, sizeof(double));
   f->a = (double *)dn__take(a, dn__mul(m, m), sizeof(double));
   f->z = (double *)dn__take(a, dn__mul(m, m), sizeof(double));
   f->d = (double *)dn__take(a, m, sizeof(double));
   f->e = (double *)dn__take(a, m, sizeof(double));
   f->v = (double *)dn__take(a, m, sizeof(double));
   f->w = (double *)dn__take(a, m, sizeof(double));
}
DN_API size_t dn_factor_scratch(size_t rows, size_t pairs, size_t factors)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn__factor f;
   dn__factor_layout(&f, rows, pairs, factors, &a);
   return dn__gauge(&a);
}
static double dn__factor_floor(double variance) { return 1e-6 * variance > 1e-12 ? 1e-6 * variance : 1e-12; }
/* mean, centred rows, row variances, Psi's start, and S where the rows are the fewer */
static dn_result dn__factor_open(const dn_factor_desc *q, dn__factor *f, dn_error *err)
{
   size_t D = q->rows, P = q->pairs, i, j, k;
   for (i = 0; i < D; i++) {
      double sum = 0.0, square = 0.0;
      for (j = 0; j < P; j++) {
         if (!dn__finite(q->distances[i * P + j]))
            return dn__fail_sizes(err, DN_BAD_VALUE, "factor analysis", i, "row ", i, ", pair ", j, ": a distance is not finite");
         sum += (double)q->distances[i * P + j];
      }
      f->mean[i] = sum / (double)P;
      for (j = 0; j < P; j++) {
         f->x[i * P + j] = (double)q->distances[i * P + j] - f->mean[i];
         square += f->x[i * P + j] * f->x[i * P + j];
      }
      f->variance[i] = square / (double)P;
      f->psi[i] = f->variance[i];
      if (q->start) {
         f->psi[i] = (double)q->start[i];
         if (!dn__finite(q->start[i]) || !(q->start[i] > 0.0f))
            return dn__fail_sizes(err, DN_BAD_VALUE, "factor analysis", i, "start ", i, NULL, 0, ": expected a finite variance above 0");
      }
      if (f->psi[i] < dn__factor_floor(f->variance[i])) f->psi[i] = dn__factor_floor(f->variance[i]);
   }
   for (i = 0; D <= P && i < D; i++)
      for (j = 0; j <= i; j++) {
         double sum = 0.0;
         for (k = 0; k < P; k++) sum += f->x[i * P + k] * f->x[j * P + k];
         f->cov[i * D + j] = f->cov[j * D + i] = sum / (double)P;
      }
   return DN_OK;
}
/* the best L for this Psi; returns the mean log-likelihood of both:
      -1/2 ( D log 2 pi + log det (L L^T + Psi) + tr (L L^T + Psi)^-1 S )
   where with the eigenvalues l_k = s_k^2 of Psi^-1/2 S Psi^-1/2 the determinant is prod psi_i prod max(l_k, 1) and the
   trace is sum S_ii / psi_i - sum max(l_k - 1, 0), k over the n factors */
static double dn__factor_round(const dn_factor_desc *q, dn__factor *f)
{
   size_t D = q->rows, P = q->pairs, n = q->factors, m = dn__min(D, P), i, j, k;
   double value = (double)D * 1.8378770664093453; /* log 2 pi */
   if (D <= P) {
      for (i = 0; i < D; i++) f->v[i] = 1.0 / DN_SQRT(f->psi[i]);
      for (i = 0; i < D; i++)
         for (j = 0; j < D; j++) f->a[i * D + j] = f->cov[i * D + j] * f->v[i] * f->v[j];
   } else { /* the other Gram matrix, X^T X: the same eigenvalues but for zeros */
      memset(f->a, 0, P * P * sizeof *f->a);
      for (i = 0; i < D; i++) {
         const double *x = f->x + i * P;
         double scale = 1.0 / (f->psi[i] * (double)P);
         for (j = 0; j < P; j++) {
            double c = x[j] * scale;
            for (k = 0; k <= j; k++) f->a[j * P + k] += c * x[k];
         }
      }
      for (j = 0; j < P; j++)
         for (k = j + 1; k < P; k++) f->a[j * P + k] = f->a[k * P + j];
   }
   dn__eigen(f->a, m, f->d, f->z, f->e, f->v, f->w);
   for (i = 0; i < D; i++) value += dn__log(f->psi[i]) + f->variance[i] / f->psi[i];
   for (k = 0; k < n; k++) {
      double l = f->d[k], scale, most = 0.0;
      const double *z = f->z + k * m;
      if (l > 1.0) value += dn__log(l) - (l - 1.0);
      scale = l > 1.0 ? DN_SQRT(D <= P ? l - 1.0 : (l - 1.0) / (l * (double)P)) : 0.0;
      for (i = 0; i < D; i++) { /* L_k = Psi^1/2 u_k sqrt(l_k - 1); u_k = X w_k / s_k when the pairs are the fewer */
         double u = 0.0;
         if (D <= P) u = z[i] * DN_SQRT(f->psi[i]);
         else
            for (j = 0; j < P; j++) u += f->x[i * P + j] * z[j];
         f->loading[i * n + k] = scale * u;
         if (DN_FABS(scale * u) > DN_FABS(most)) most = scale * u;
      }
      for (i = 0; most < 0.0 && i < D; i++) f->loading[i * n + k] = -f->loading[i * n + k];
   }
   return -0.5 * value;
}
static void dn__factor_write(const dn_factor_desc *q, const dn__factor *f)
{
   size_t D = q->rows, P = q->pairs, n = q->factors, i, j, k;
   for (i = 0; i < D; i++) {
      if (q->mean) q->mean[i] = (float)f->mean[i];
      if (q->noise) q->noise[i] = (float)f->psi[i];
      for (k = 0; q->loading && k < n; k++) q->loading[i * n + k] = (float)f->loading[i * n + k];
   }
   for (k = 0; k < n; k++) { /* L^T Psi^-1 L is diagonal here: its entries are l_k - 1, and I + that is l_k or 1 */
      double l = 1.0;
      for (i = 0; i < D; i++) l += f->loading[i * n + k] * f->loading[i * n + k] / f->psi[i];
      for (i = 0; q->projection && i < D; i++) q->projection[k * D + i] = (float)(f->loading[i * n + k] / (f->psi[i] * l));
      for (j = 0; q->alpha && j < P; j++) {
         double sum = 0.0;
         for (i = 0; i < D; i++) sum += f->loading[i * n + k] / f->psi[i] * f->x[i * P + j];
         q->alpha[k * P + j] = (float)(sum / l);
      }
   }
}
DN_API dn_result dn_factor_fit(dn_factor_desc *q, void *scratch, size_t scratch_bytes, dn_error *err)
{
   static const char where[] = "factor analysis";
   dn__arena arena = dn__arena_of(scratch, scratch_bytes);
   dn__factor f;
   dn_result result;
   size_t i, k;
   double before = 0.0;
   DN_ASSERT(q && q->distances && scratch);
   q->rounds = 0;
   q->log_likelihood = 0.0;
   if (q->rows == 0 || q->pairs < 2)
      return dn__fail_sizes(err, DN_BAD_SHAPE, where, SIZE_MAX, "found ", q->rows, " rows of ", q->pairs, " pairs, expected at least 1 of 2");
   if (q->factors == 0 || q->factors > dn__min(q->rows, q->pairs))
      return dn__fail_sizes(err, DN_BAD_SHAPE, where, SIZE_MAX, "found ", q->factors, " factors, expected 1 to ", dn__min(q->rows, q->pairs), NULL);
   dn__factor_layout(&f, q->rows, q->pairs, q->factors, &arena);
   if (arena.used > scratch_bytes)
      return dn__fail_sizes(err, DN_TOO_SMALL, where, SIZE_MAX, "scratch: ", scratch_bytes, " bytes given, needed ", arena.used, NULL);
   if ((result = dn__factor_open(q, &f, err)) != DN_OK) return result;
   for (;;) {
      double value = dn__factor_round(q, &f);
      if (q->history && q->rounds < q->history_count) q->history[q->rounds] = value;
      q->log_likelihood = value;
      q->rounds++;
      if (q->progress && q->progress->step && q->progress->step(q->progress->user, where, (float)q->rounds / 20000.0f))
         result = dn__fail(err, DN_CANCELLED, where, SIZE_MAX, "cancelled by the progress callback");
      if (result != DN_OK || q->rounds == 20000 || (q->rounds > 1 && !(value - before > 1e-12 * DN_FABS(value)))) break;
      before = value;
      for (i = 0; i < q->rows; i++) { /* Psi = diag(S - L L^T) */
         double left = f.variance[i];
         for (k = 0; k < q->factors; k++) left -= f.loading[i * q->factors + k] * f.loading[i * q->factors + k];
         f.psi[i] = left > dn__factor_floor(f.variance[i]) ? left : dn__factor_floor(f.variance[i]);
      }
   }
   dn__factor_write(q, &f);
   return result;
}
DN_API void dn_factor_project(const float *projection, const float *mean, const float *d, size_t rows, size_t factors, float *alpha)
{
   size_t k, i;
   for (k = 0; k < factors; k++) {
      double sum = 0.0;
      for (i = 0; i < rows; i++) sum += (double)projection[k * rows + i] * ((double)d[i] - (double)mean[i]);
      alpha[k] = (float)sum;
   }
}

/* --- surfaces. Triangles in the order of a space-filling curve, cut into as many equal leaves as a power of two gives
   about DN__LEAF each; the boxes over them make a binary tree without pointers. Refitting needs no rebuild, but sorting
   again is as cheap, and keeps the tree good in every pose. */
typedef struct dn__sorter { uint32_t *key, *spare_key, *spare; } dn__sorter;
static size_t dn__surface_leaves(size_t triangles)
{
   size_t n = 1;
   while (n <= triangles / DN__LEAF / 2) n *= 2;
   return n;
}
static void dn__surface_layout(dn_surface *s, size_t vertices, size_t triangles, dn__sorter *sort, dn__arena *a)
{
   s->leaves = dn__surface_leaves(triangles);
   s->corner_first = (uint32_t *)dn__take(a, dn__add(vertices, 1), sizeof(uint32_t));
   s->corner_tri = (uint32_t *)dn__take(a, dn__mul(triangles, 3), sizeof(uint32_t));
   s->order = (uint32_t *)dn__take(a, triangles, sizeof(uint32_t));
   s->boxes = (float *)dn__take(a, dn__mul(s->leaves, 12), sizeof(float));
   sort->key = (uint32_t *)dn__take(a, triangles, sizeof(uint32_t));
   sort->spare_key = (uint32_t *)dn__take(a, triangles, sizeof(uint32_t));
   sort->spare = (uint32_t *)dn__take(a, triangles, sizeof(uint32_t));
}
DN_API size_t dn_surface_size(size_t vertices, size_t triangles)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn__sorter sort;
   dn_surface s;
   dn__surface_layout(&s, vertices, triangles, &sort, &a);
   return dn__gauge(&a);
}
static uint32_t dn__spread_bits(uint32_t v) /* ten bits to every third place */
{
   v = (v | v << 16) & 0x030000ffu;
   v = (v | v << 8) & 0x0300f00fu;
   v = (v | v << 4) & 0x030c30c3u;
   return (v | v << 2) & 0x09249249u;
}
static void dn__surface_sort(uint32_t *order, const dn__sorter *s, size_t count) /* by key, stable, three times ten bits */
{
   uint32_t at[1024], *key = s->key, *from = order, *key_to = s->spare_key, *to = s->spare, *swap;
   size_t i;
   unsigned shift;
   for (shift = 0; shift < 30; shift += 10) {
      uint32_t total = 0;
      memset(at, 0, sizeof at);
      for (i = 0; i < count; i++) at[key[i] >> shift & 1023u]++;
      for (i = 0; i < 1024; i++) {
         uint32_t n = at[i];
         at[i] = total;
         total += n;
      }
      for (i = 0; i < count; i++) {
         uint32_t place = at[key[i] >> shift & 1023u]++;
         key_to[place] = key[i];
         to[place] = from[i];
      }
      swap = key, key = key_to, key_to = swap;
      swap = from, from = to, to = swap;
   }
   memcpy(order, from, count * sizeof *order); /* an odd number of passes ends in spare */
}
static size_t dn__leaf_begin(const dn_surface *s, size_t leaf) { return (size_t)((uint64_t)leaf * s->triangles / s->leaves); }
static void dn__box_add(float box[6], const float *p) /* NaN widens nothing */
{
   int k;
   for (k = 0; k < 3; k++) {
      if (p[k] < box[k]) box[k] = p[k];
      if (p[k] > box[3 + k]) box[3 + k] = p[k];
   }
}
DN_API void dn_surface_build(dn_surface *s, const float *positions, size_t vertices, const uint32_t *triangle,
                             size_t triangles, void *memory)
{
   static const float empty[6] = { 3e38f, 3e38f, 3e38f, -3e38f, -3e38f, -3e38f };
   dn__arena a = dn__arena_of(memory, SIZE_MAX);
   dn__sorter sort;
   float whole[6], scale[3], square = 0.0f;
   uint32_t *order;
   float *boxes;
   size_t t, i, k;
   DN_ASSERT(memory && triangles > 0 && triangles <= DN__MOST && vertices <= DN__MOST);
   dn__surface_layout(s, vertices, triangles, &sort, &a);
   s->positions = positions;
   s->triangle = triangle;
   s->vertices = vertices;
   s->triangles = triangles;
   order = (uint32_t *)s->order;
   boxes = (float *)s->boxes;
   dn__corners_build(triangle, triangles, vertices, (uint32_t *)s->corner_first, (uint32_t *)s->corner_tri);
   memcpy(whole, empty, sizeof whole);
   for (t = 0; t < 3 * triangles; t++) dn__box_add(whole, positions + 3 * (size_t)triangle[t]);
   for (k = 0; k < 3; k++) {
      float side = whole[3 + k] - whole[k];
      scale[k] = side > 0.0f ? 341.0f / side : 0.0f; /* a centre is a sum of three: 0 to 1023 */
      square += side * side;
   }
   s->extent = square >= 0.0f && dn__finite(square) ? DN_SQRTF(square) : 0.0f;
   for (t = 0; t < triangles; t++) {
      uint32_t code = 0;
      for (k = 0; k < 3; k++) {
         float sum = 0.0f;
         for (i = 0; i < 3; i++) sum += (positions[3 * (size_t)triangle[3 * t + i] + k] - whole[k]) * scale[k];
         code |= dn__spread_bits(sum > 0.0f ? sum < 1023.0f ? (uint32_t)sum : 1023u : 0u) << k;
      }
      sort.key[t] = code;
      order[t] = (uint32_t)t;
   }
   dn__surface_sort(order, &sort, triangles);
   for (i = s->leaves; i-- > 0;) {
      float *box = boxes + 6 * (s->leaves + i);
      memcpy(box, empty, sizeof empty);
      for (t = dn__leaf_begin(s, i); t < dn__leaf_begin(s, i + 1); t++)
         for (k = 0; k < 3; k++) dn__box_add(box, positions + 3 * (size_t)triangle[3 * (size_t)order[t] + k]);
   }
   for (i = s->leaves; i-- > 1;) {
      float *box = boxes + 6 * i;
      memcpy(box, boxes + 12 * i, sizeof empty);
      dn__box_add(box, boxes + 12 * i + 6); /* no leaf is empty; one of nothing finite only makes its parents too wide */
      dn__box_add(box, boxes + 12 * i + 9);
   }
}

/* the place on a triangle that is closest to a point, and which part of it that is on */
typedef enum dn__part { DN__FACE, DN__EDGE_AB, DN__EDGE_BC, DN__EDGE_CA, DN__AT_A, DN__AT_B, DN__AT_C } dn__part;
typedef struct dn__near { double square, at[3]; uint32_t triangle; dn__part part; } dn__near;

static void dn__corner(const dn_surface *s, size_t triangle, size_t corner, double out[3])
{
   const float *p = s->positions + 3 * (size_t)s->triangle[3 * triangle + corner];
   out[0] = (double)p[0];
   out[1] = (double)p[1];
   out[2] = (double)p[2];
}
static void dn__near_segment(dn__near *n, const double p[3], const double a[3], const double b[3], uint32_t triangle,
                             dn__part inner, dn__part at_a, dn__part at_b)
{
   double u[3], v[3], q[3], along, length, square, reach = n->square * 1.000001;
   int k;
   for (k = 0; k < 3; k++) u[k] = b[k] - a[k], v[k] = p[k] - a[k];
   along = dn__dot3(u, v);
   length = dn__dot3(u, u);
   square = dn__dot3(v, v);
   if (along <= 0.0 ? square > reach : along < length ? square * length - along * along > (reach + 1e-12 * square) * length
                                                      : square - 2.0 * along + length > reach + 1e-12 * (square + length)) return;
   along = along > 0.0 ? along < length ? along / length : 1.0 : 0.0; /* a segment without length: its end a */
   for (k = 0; k < 3; k++) q[k] = along < 1.0 ? a[k] + along * u[k] : b[k];
   for (k = 0; k < 3; k++) v[k] = p[k] - q[k];
   square = dn__dot3(v, v);
   if (square < n->square || (square == n->square && triangle < n->triangle)) {
      n->square = square;
      n->triangle = triangle;
      n->part = along > 0.0 ? along < 1.0 ? inner : at_b : at_a;
      memcpy(n->at, q, sizeof q);
   }
}
/* n keeps the better of itself and this triangle; of two as near, the lower index */
static void dn__near_triangle(const dn_surface *s, uint32_t triangle, const double p[3], dn__near *n)
{
   double a[3], b[3], c[3], u[3], v[3], w[3], normal[3], x[3], area, beta, gamma, square;
   int k;
   dn__corner(s, triangle, 0, a);
   dn__corner(s, triangle, 1, b);
   dn__corner(s, triangle, 2, c);
   for (k = 0; k < 3; k++) u[k] = b[k] - a[k], v[k] = c[k] - a[k], w[k] = p[k] - a[k];
   dn__cross3(u, v, normal);
   area = dn__dot3(normal, normal);
   if (!(area >= 0.0)) return; /* a corner is not finite */
   if (area > 1e-24 * dn__dot3(u, u) * dn__dot3(v, v)) { /* p = a + beta u + gamma v + height normal */
      double height = dn__dot3(w, normal);
      if (height * height >= n->square * area * 1.000001) return; /* its plane is too far */
      dn__cross3(w, v, x);
      beta = dn__dot3(x, normal) / area;
      dn__cross3(u, w, x);
      gamma = dn__dot3(x, normal) / area;
      if (beta > 0.0 && gamma > 0.0 && beta + gamma < 1.0) {
         square = height * height / area;
         if (square < n->square || (square == n->square && triangle < n->triangle)) {
            n->square = square;
            n->triangle = triangle;
            n->part = DN__FACE;
            for (k = 0; k < 3; k++) n->at[k] = a[k] + beta * u[k] + gamma * v[k];
         }
         return;
      }
      /* a corner's side: only the edges that face p can be closest */
      if (gamma <= 0.0) dn__near_segment(n, p, a, b, triangle, DN__EDGE_AB, DN__AT_A, DN__AT_B);
      if (beta + gamma >= 1.0) dn__near_segment(n, p, b, c, triangle, DN__EDGE_BC, DN__AT_B, DN__AT_C);
      if (beta <= 0.0) dn__near_segment(n, p, c, a, triangle, DN__EDGE_CA, DN__AT_C, DN__AT_A);
   } else { /* no area: three segments */
      dn__near_segment(n, p, a, b, triangle, DN__EDGE_AB, DN__AT_A, DN__AT_B);
      dn__near_segment(n, p, b, c, triangle, DN__EDGE_BC, DN__AT_B, DN__AT_C);
      dn__near_segment(n, p, c, a, triangle, DN__EDGE_CA, DN__AT_C, DN__AT_A);
   }
}
static int dn__unit_face(const dn_surface *s, size_t triangle, double n[3]) /* 0: no area */
{
   double a[3], u[3], v[3], length;
   int k;
   dn__corner(s, triangle, 0, a);
   dn__corner(s, triangle, 1, u);
   dn__corner(s, triangle, 2, v);
   for (k = 0; k < 3; k++) u[k] -= a[k], v[k] -= a[k];
   dn__cross3(u, v, n);
   length = DN_SQRT(dn__dot3(n, n));
   for (k = 0; k < 3; k++) n[k] = length > 0.0 ? n[k] / length : 0.0;
   return length > 0.0;
}
static double dn__angle(double y, double x) /* of (x, y), y >= 0: 0 .. pi, to 5e-7 */
{
   double size = DN_FABS(x), tiny = size < y ? size : y, large = size < y ? y : size, t, u, a;
   if (!(large > 0.0)) return 0.0;
   t = tiny / large;
   u = t * t;
   a = t * (0.99999933 + u * (-0.33326375 + u * (0.19879872 + u * (-0.13480406 + u * (0.08374156 + u * (-0.03689863 + u * 0.00782548))))));
   if (size < y) a = 1.5707963267948966 - a;
   return x < 0.0 ? 3.141592653589793 - a : a;
}
static size_t dn__corner_of(const dn_surface *s, size_t triangle, uint32_t vertex)
{
   const uint32_t *t = s->triangle + 3 * triangle;
   return t[0] == vertex ? 0 : t[1] == vertex ? 1 : 2;
}
static uint64_t dn__mix(uint64_t h) /* sums of these tell sets apart */
{
   h = (h + 0x9e3779b97f4a7c15u) * 0xff51afd7ed558ccdu;
   return (h ^ h >> 32) * 0xc4ceb9fe1a85ec53u;
}
/* the direction that tells the side there, not of unit length; *open: it is on a border of the surface */
static void dn__near_normal(const dn_surface *s, const dn__near *n, double normal[3], int *open)
{
   const uint32_t *t = s->triangle + 3 * (size_t)n->triangle;
   size_t at = n->part == DN__EDGE_AB || n->part == DN__AT_A ? 0 : n->part == DN__EDGE_BC || n->part == DN__AT_B ? 1 : 2;
   uint32_t e, a = t[at], b = t[(at + 1) % 3];
   uint64_t balance = 0;
   int k;
   *open = 0;
   if (n->part == DN__FACE) {
      dn__unit_face(s, n->triangle, normal);
      return;
   }
   normal[0] = normal[1] = normal[2] = 0.0;
   for (e = s->corner_first[a]; e < s->corner_first[a + 1]; e++) {
      size_t f = s->corner_tri[e], c = dn__corner_of(s, f, a);
      uint32_t next = s->triangle[3 * f + (c + 1) % 3], last = s->triangle[3 * f + (c + 2) % 3];
      double face[3], weight = 1.0;
      if (next == last || next == a || last == a) continue;
      if (n->part >= DN__AT_A) balance += dn__mix(next) - dn__mix(last); /* each spoke once out and once in: closed */
      else if (next == b) balance++;
      else if (last == b) balance--;
      else continue;
      if (!dn__unit_face(s, f, face)) continue;
      if (n->part >= DN__AT_A) {
         double p[3], u[3], v[3], x[3];
         dn__corner(s, f, c, p);
         dn__corner(s, f, (c + 1) % 3, u);
         dn__corner(s, f, (c + 2) % 3, v);
         for (k = 0; k < 3; k++) u[k] -= p[k], v[k] -= p[k];
         dn__cross3(u, v, x);
         weight = dn__angle(DN_SQRT(dn__dot3(x, x)), dn__dot3(u, v));
      }
      for (k = 0; k < 3; k++) normal[k] += weight * face[k];
   }
   *open = balance != 0;
}
/* distance, closest place and unit normal from the nearest feature */
static double dn__signed(const dn_surface *s, const double p[3], const dn__near *n, double normal[3])
{
   double way[3], length, size, side;
   int k, open;
   dn__near_normal(s, n, normal, &open);
   for (k = 0; k < 3; k++) way[k] = p[k] - n->at[k];
   length = DN_SQRT(dn__dot3(way, way));
   size = DN_SQRT(dn__dot3(normal, normal));
   for (k = 0; k < 3; k++) normal[k] = size > 0.0 ? normal[k] / size : 0.0;
   side = dn__dot3(way, normal);
   if (open && side > -0.5 * length) side = 0.0; /* past a border, not under it */
   if (length > 1e-6 * (double)s->extent && length > 1e-30)
      for (k = 0; k < 3; k++) normal[k] = side < 0.0 ? -way[k] / length : way[k] / length;
   return side < 0.0 ? -length : length;
}
static float dn__box_square(const float box[6], const float p[3])
{
   float sum = 0.0f;
   int k;
   for (k = 0; k < 3; k++) {
      float low = box[k] - p[k], high = p[k] - box[3 + k], out = low > high ? low : high;
      if (out > 0.0f) sum += out * out;
   }
   return sum;
}
/* the nearest place on the surface; square stays 1e300 when no triangle is finite. Boxes are compared in float, with a
   millionth to spare; triangles are measured in double. hint: a triangle that is likely near, or DN__NONE; it saves
   boxes, and cannot change the answer, which is the least of all (square, triangle). */
static void dn__surface_nearest(const dn_surface *s, const float point[3], uint32_t hint, dn__near *n)
{
   struct { uint32_t box; float square; } stack[64]; /* two a level, 28 levels at most */
   size_t depth = 0;
   uint32_t box = 1;
   float here = 0.0f;
   double p[3];
   int k;
   for (k = 0; k < 3; k++) p[k] = (double)point[k];
   n->square = 1e300;
   n->triangle = DN__NONE;
   if (hint != DN__NONE) dn__near_triangle(s, hint, p, n);
   for (;;) {
      if ((double)here * 0.999999 <= n->square) {
         if (box >= s->leaves) {
            size_t t, end = dn__leaf_begin(s, box - s->leaves + 1);
            for (t = dn__leaf_begin(s, box - s->leaves); t < end; t++) dn__near_triangle(s, s->order[t], p, n);
         } else {
            float left = dn__box_square(s->boxes + 12 * (size_t)box, point);
            float right = dn__box_square(s->boxes + 12 * (size_t)box + 6, point);
            uint32_t other = 2 * box + (left <= right);
            stack[depth].box = other;
            stack[depth++].square = left <= right ? right : left;
            box = other ^ 1u;
            here = left <= right ? left : right;
            continue;
         }
      }
      if (depth == 0) return;
      box = stack[--depth].box;
      here = stack[depth].square;
   }
}
static float dn__surface_answer(const dn_surface *s, const float point[3], const dn__near *n, float *closest, float *normal)
{
   double p[3], direction[3] = { 0.0, 0.0, 0.0 }, distance = 3e38;
   int k;
   for (k = 0; k < 3; k++) p[k] = (double)point[k];
   if (n->triangle != DN__NONE) distance = dn__signed(s, p, n, direction);
   for (k = 0; k < 3; k++) {
      if (closest) closest[k] = n->triangle != DN__NONE ? (float)n->at[k] : point[k];
      if (normal) normal[k] = (float)direction[k];
   }
   return (float)distance;
}
DN_API float dn_surface_distance(const dn_surface *surface, const float point[3], float *closest, float *normal)
{
   dn__near n;
   dn__surface_nearest(surface, point, DN__NONE, &n);
   return dn__surface_answer(surface, point, &n, closest, normal);
}
DN_API float dn_surface_distance_ref(const dn_surface *surface, const float point[3], float *closest, float *normal)
{
   dn__near n;
   double p[3];
   size_t t;
   int k;
   for (k = 0; k < 3; k++) p[k] = (double)point[k];
   n.square = 1e300;
   n.triangle = DN__NONE;
   for (t = 0; t < surface->triangles; t++) dn__near_triangle(surface, (uint32_t)t, p, &n);
   return dn__surface_answer(surface, point, &n, closest, normal);
}

/* --- collisions. A vertex is pushed to where its worst obstacle leaves it its margin, and asked again: in a groove the
   two sides take turns. What is left after DN__DEEP / 2 turns is squeezed between surfaces; half steps then settle it
   between them. Then the pushes are averaged over the pushed vertices' neighbours and made up to what each one needs. */
enum { DN__SPREAD = 8 /* rounds */, DN__REACH = 16, DN__TRAVEL = 20 /* margins */ };
typedef struct dn__collide_job {
   const dn_obstacle *obstacles;
   size_t count;
   const dn_graph *graph;
   float *positions;
   const float *start;  /* (V,3) before */
   float *need;         /* (V,3) the least push */
   const float *from;   /* (V,3) a round of spreading */
   float *to;
   float *before;       /* (V) how far behind a surface it was; negative: not at all */
   float *left;         /* (V) what a margin still lacks; negative: nothing was asked of this vertex */
} dn__collide_job;
typedef struct dn__squeeze { double slack; float closest[3], normal[3], margin, spare, depth; } dn__squeeze;
enum { DN__HINTS = 4 }; /* obstacles whose last closest triangle is remembered from vertex to vertex of a range */

static void dn__collide_ask(const dn__collide_job *j, const float p[3], uint32_t *hint, dn__squeeze *worst)
{
   size_t i;
   worst->slack = 1e300;
   worst->depth = -3e38f;
   for (i = 0; i < j->count; i++) {
      const dn_obstacle *o = j->obstacles + i;
      float closest[3], normal[3], distance;
      double slack;
      dn__near n;
      dn__surface_nearest(o->surface, p, i < DN__HINTS ? hint[i] : DN__NONE, &n);
      if (i < DN__HINTS) hint[i] = n.triangle;
      distance = dn__surface_answer(o->surface, p, &n, closest, normal);
      slack = (double)distance - (double)o->margin;
      if (o->reach > 0.0f && distance < -o->reach) continue;
      if (-distance > worst->depth) worst->depth = -distance;
      if (!(slack < worst->slack)) continue;
      worst->slack = slack;
      worst->margin = o->margin;
      worst->spare = 1e-3f * o->margin + 1e-6f * o->surface->extent; /* more than a float position can round away */
      memcpy(worst->closest, closest, sizeof closest);
      memcpy(worst->normal, normal, sizeof normal);
   }
}
/* One step out of a squeeze. The plane through its closest place asks x for a = m + n.(c - x) along n. Where going there
   breaks the plane asked before it, the step keeps both: the shortest way s = l0 n0 + l1 n1 with n0.s = a0, n1.s = a1,
   along the groove's bisector; but no further than DN__REACH times what is asked, else the groove is too sharp. */
static void dn__collide_step(const dn__squeeze *now, const dn__squeeze *last, float x[3])
{
   double a0 = 0.0, a1 = 0.0, g = 0.0, l0, l1, flat, way[3], square = 0.0;
   int k;
   for (k = 0; k < 3; k++) a1 += (double)now->normal[k] * ((double)now->closest[k] - (double)x[k]);
   a1 += (double)now->margin + (double)now->spare;
   for (k = 0; k < 3; k++) way[k] = a1 * (double)now->normal[k];
   if (last) {
      for (k = 0; k < 3; k++) {
         a0 += (double)last->normal[k] * ((double)last->closest[k] - (double)x[k]);
         g += (double)last->normal[k] * (double)now->normal[k];
      }
      a0 += (double)last->margin + (double)last->spare;
      flat = 1.0 - g * g;
      if (g * a1 < a0 && flat > 1e-3) { /* [1 g; g 1] [l0; l1] = [a0; a1] */
         l0 = (a0 - g * a1) / flat;
         l1 = (a1 - g * a0) / flat;
         for (k = 0; k < 3; k++) square += (l0 * (double)last->normal[k] + l1 * (double)now->normal[k]) * (l0 * (double)last->normal[k] + l1 * (double)now->normal[k]);
         if (l1 > 0.0 && square < (double)DN__REACH * (double)DN__REACH * (a1 * a1 + a0 * a0))
            for (k = 0; k < 3; k++) way[k] = l0 * (double)last->normal[k] + l1 * (double)now->normal[k];
      }
   }
   for (k = 0; k < 3; k++) x[k] = (float)((double)x[k] + way[k]);
}
/* out to the margins; returns what is left to the worst of them, at least 0 when all are kept. ask: for p, known */
static double dn__collide_push(const dn__collide_job *j, float p[3], uint32_t *hint, dn__squeeze ask)
{
   float x[3], best[3];
   double most = ask.slack, reach = 2.0 * ((double)ask.margin - ask.slack) + (double)DN__TRAVEL * (double)ask.margin;
   dn__squeeze last;
   int step, k;
   memcpy(x, p, sizeof x);
   memcpy(best, p, sizeof best);
   for (step = 0; step < DN__DEEP && ask.slack < 0.0; step++) {
      float from[3];
      memcpy(from, x, sizeof from);
      dn__collide_step(&ask, step ? &last : NULL, x);
      if (step >= DN__DEEP / 2)
         for (k = 0; k < 3; k++) x[k] = from[k] + 0.5f * (x[k] - from[k]);
      last = ask;
      dn__collide_ask(j, x, hint, &ask);
      if (ask.slack > most && dn__square_distance(x, p) <= reach * reach) { /* a hole in the cloth is worse than a squeeze */
         most = ask.slack;
         memcpy(best, x, sizeof best);
      }
   }
   memcpy(p, best, sizeof best);
   return most;
}
static void dn__collide_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__collide_job *j = (const dn__collide_job *)job;
   uint32_t hint[DN__HINTS] = { DN__NONE, DN__NONE, DN__NONE, DN__NONE };
   size_t v;
   int k;
   (void)worker;
   for (v = begin; v < end; v++) {
      float *p = j->positions + 3 * v;
      dn__squeeze ask;
      j->left[v] = j->before[v] = -1.0f;
      for (k = 0; k < 3; k++) j->need[3 * v + (size_t)k] = 0.0f;
      if (!dn__finite(p[0]) || !dn__finite(p[1]) || !dn__finite(p[2])) continue;
      dn__collide_ask(j, p, hint, &ask);
      if (!(ask.slack < 0.0)) continue;
      j->before[v] = ask.depth;
      ask.slack = dn__collide_push(j, p, hint, ask);
      j->left[v] = ask.slack < 0.0 ? (float)-ask.slack : 0.0f;
      for (k = 0; k < 3; k++) j->need[3 * v + (size_t)k] = p[k] - j->start[3 * v + (size_t)k];
   }
}
static void dn__collide_spread(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__collide_job *j = (const dn__collide_job *)job;
   size_t v, k;
   (void)worker;
   for (v = begin; v < end; v++) {
      const float *need = j->need + 3 * v, *own = j->from + 3 * v;
      uint32_t e, first = j->graph->first[v], last = j->graph->first[v + 1];
      double square = 0.0, lacks = 0.0, way[3];
      memcpy(j->to + 3 * v, own, 3 * sizeof *own);
      for (k = 0; k < 3; k++) square += (double)need[k] * (double)need[k];
      if (!(square > 0.0) || first == last) continue;
      for (k = 0; k < 3; k++) {
         double sum = 0.0;
         for (e = first; e < last; e++) sum += (double)j->from[3 * (size_t)j->graph->next[e] + k];
         way[k] = 0.5 * (double)own[k] + 0.5 * sum / (double)(last - first);
         lacks += ((double)need[k] - way[k]) * (double)need[k];
      }
      for (k = 0; k < 3; k++) /* along its own push at least as far as it needs */
         j->to[3 * v + k] = (float)(way[k] + (lacks > 0.0 ? lacks / square * (double)need[k] : 0.0));
   }
}
static void dn__collide_settle(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__collide_job *j = (const dn__collide_job *)job;
   uint32_t hint[DN__HINTS] = { DN__NONE, DN__NONE, DN__NONE, DN__NONE };
   size_t v, k;
   (void)worker;
   for (v = begin; v < end; v++) {
      float x[3];
      dn__squeeze ask;
      if (j->left[v] != 0.0f) continue; /* untouched, or squeezed: stays where it is */
      for (k = 0; k < 3; k++) x[k] = j->start[3 * v + k] + j->from[3 * v + k];
      dn__collide_ask(j, x, hint, &ask);
      if (!(ask.slack < 0.0) || !(dn__collide_push(j, x, hint, ask) < 0.0)) memcpy(j->positions + 3 * v, x, sizeof x);
   }
}
static void dn__collide_layout(dn__collide_job *j, size_t vertices, dn__arena *a)
{
   j->start = (float *)dn__take(a, dn__mul(vertices, 3), sizeof(float));
   j->need = (float *)dn__take(a, dn__mul(vertices, 3), sizeof(float));
   j->from = (float *)dn__take(a, dn__mul(vertices, 3), sizeof(float));
   j->to = (float *)dn__take(a, dn__mul(vertices, 3), sizeof(float));
   j->before = (float *)dn__take(a, vertices, sizeof(float));
   j->left = (float *)dn__take(a, vertices, sizeof(float));
}
DN_API size_t dn_collide_scratch(size_t vertices)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn__collide_job j;
   dn__collide_layout(&j, vertices, &a);
   return dn__gauge(&a);
}
DN_API void dn_collide(const dn_obstacle *obstacles, size_t count, const dn_graph *graph, float *positions, size_t vertices,
                       dn_collision *report, void *scratch, const dn_parallel *parallel)
{
   dn__arena a = dn__arena_of(scratch, SIZE_MAX);
   dn__collide_job j;
   dn_collision found;
   size_t v, k;
   int round;
   DN_ASSERT(scratch && (count == 0 || obstacles) && (!graph || graph->nodes == vertices));
   memset(&found, 0, sizeof found);
   dn__collide_layout(&j, vertices, &a);
   j.obstacles = obstacles;
   j.count = count;
   j.graph = graph;
   j.positions = positions;
   memcpy((float *)j.start, positions, 3 * vertices * sizeof *positions);
   dn__for(parallel, vertices, DN__KIT_GRAIN, dn__collide_range, &j);
   for (v = 0; v < vertices; v++) found.moved += j.left[v] >= 0.0f;
   if (graph && found.moved > 0) {
      memcpy((float *)j.from, j.need, 3 * vertices * sizeof *positions);
      for (round = 0; round < DN__SPREAD; round++) {
         float *swap = (float *)j.from;
         dn__for(parallel, vertices, DN__KIT_GRAIN, dn__collide_spread, &j);
         j.from = j.to;
         j.to = swap;
      }
      dn__for(parallel, vertices, DN__KIT_GRAIN, dn__collide_settle, &j);
   }
   for (v = 0; v < vertices; v++) {
      double square = 0.0, way;
      if (!(j.left[v] >= 0.0f)) continue;
      found.inside += j.before[v] > 0.0f;
      found.squeezed += j.left[v] > 0.0f;
      if (j.before[v] > found.deepest) found.deepest = j.before[v];
      if (j.left[v] > found.left) found.left = j.left[v];
      for (k = 0; k < 3; k++) {
         way = (double)positions[3 * v + k] - (double)j.start[3 * v + k];
         square += way * way;
      }
      way = DN_SQRT(square);
      if ((float)way > found.farthest) found.farthest = (float)way;
   }
   if (report) *report = found;
}

/* --- shapes. Checked in full by dn__shape_open, which the size query and the initialiser share; then copied. */
struct dn_shape {
   dn_shape_view view;
   const dn_allocator *allocator; /* points at the copy below, or NULL: DN_MALLOC */
   dn_allocator allocator_copy;
   int owned;
   size_t pose_coefficients;      /* 9 (S-1), or 0 */
   const float *shapedirs;        /* (B,V,3): each coefficient's rows lie together */
   const float *posedirs;         /* (9(S-1),V,3) */
   const float *looseness;        /* (V,3) or NULL */
   const float *joint_shapedirs;  /* (B,S,3) */
   char *text;                    /* the joints' names */
};
typedef struct dn__shape_file { /* the tensors, NULL where the file has none */
   const dn_tensor *rest, *faces, *shapedirs, *weights, *posedirs, *looseness, *parents, *joint_rest, *joint_shapedirs, *regressor;
   const char *names; /* the JSON list */
   size_t names_bytes;
   size_t V, T, B, S, I;
} dn__shape_file;
static const char dn__where_shape[] = "shape";

static dn_result dn__shape_fail(dn_error *err, dn_result code, const char *name, size_t index, const char *what, size_t a,
                                const char *between, size_t b, const char *after)
{
   char line[240], text[200];
   dn_error e;
   dn__text t = dn__text_of(line, sizeof line);
   (void)dn__fail_sizes(&e, code, dn__where_shape, index, what, a, between, b, after);
   dn__join(text, sizeof text, e.info, "");
   dn__put(&t, name);
   dn__put(&t, ": ");
   dn__put(&t, text);
   return dn__fail(err, code, dn__where_shape, index, line);
}
/* the tensor of that name and shape; a side given as 0 takes any from 1 to limit. *out is NULL when it may be absent */
static dn_result dn__shape_want(const dn_tensors *file, const char *name, int needed, unsigned rank, const size_t *want,
                                size_t limit, int integers, const dn_tensor **out, dn_error *err)
{
   const dn_tensor *t = dn_tensors_find(file, name);
   char line[240];
   dn__text text = dn__text_of(line, sizeof line);
   unsigned i;
   int good;
   *out = NULL;
   dn__put(&text, name);
   if (!t) {
      if (!needed) return DN_OK;
      dn__put(&text, ": not in the file");
      return dn__fail(err, DN_MISSING_TENSOR, dn__where_shape, SIZE_MAX, line);
   }
   good = t->rank == rank;
   for (i = 0; good && i < rank; i++) good = want[i] ? t->shape[i] == want[i] : t->shape[i] >= 1 && t->shape[i] <= limit;
   if (!good) {
      dn__put(&text, ": expected (");
      for (i = 0; i < rank; i++) {
         if (i) dn__put(&text, ",");
         if (want[i]) dn__put_size(&text, want[i]);
         else dn__put(&text, "1.."), dn__put_size(&text, limit);
      }
      dn__put(&text, "), file has ");
      dn__put_shape(&text, t->shape, t->rank);
      return dn__fail(err, DN_BAD_SHAPE, dn__where_shape, SIZE_MAX, line);
   }
   if (integers ? t->format != DN_ST_I32 : t->format != DN_ST_F32 && t->format != DN_ST_F16 && t->format != DN_ST_BF16) {
      dn__put(&text, integers ? ": expected I32, file has another type" : ": expected F32, F16 or BF16, file has another type");
      return dn__fail(err, DN_BAD_TYPE, dn__where_shape, SIZE_MAX, line);
   }
   *out = t;
   return DN_OK;
}
static dn_result dn__shape_finite(const dn_tensor *t, dn_error *err)
{
   float part[64];
   size_t at, i, n;
   for (at = 0; t && at < t->count; at += n) {
      n = dn__min(t->count - at, 64);
      dn_tensor_floats(t, at, n, part);
      for (i = 0; i < n; i++)
         if (!dn__finite(part[i])) return dn__shape_fail(err, DN_BAD_VALUE, t->name, at + i, "element ", at + i, NULL, 0, " is not finite");
   }
   return DN_OK;
}
/* ["a", "b"]: S names; into text and pointers when those are given. *bytes: their text */
static dn_result dn__shape_names(const char *list, size_t joints, char *text, size_t text_bytes, const char **names,
                                 size_t *bytes, dn_error *err)
{
   dn__json j;
   char tiny[2];
   size_t n = 0, length;
   memset(&j, 0, sizeof j);
   j.file = (const unsigned char *)list;
   j.end = strlen(list);
   j.err = err;
   *bytes = 0;
   if (!dn__json_need(&j, '[', "'[' before joint_names")) return j.code;
   if (!dn__json_is(&j, ']')) {
      do {
         if (!dn__json_string(&j, "a joint name in quotes", text ? text + *bytes : tiny, text ? text_bytes - *bytes : sizeof tiny, &length)) return j.code;
         if (names && n < joints) names[n] = text + *bytes;
         *bytes += length + 1;
         n++;
      } while (dn__json_is(&j, ','));
      if (!dn__json_need(&j, ']', "',' or ']' in joint_names")) return j.code;
   }
   dn__json_space(&j);
   if (j.at != j.end) return dn__json_fail(&j, j.at, "nothing after joint_names"), j.code;
   return n == joints ? DN_OK : dn__shape_fail(err, DN_BAD_VALUE, "joint_names", SIZE_MAX, "found ", n, " names, expected ", joints, NULL);
}
static dn_result dn__shape_open(const dn_tensors *file, dn__shape_file *f, dn_error *err)
{
   size_t want[3], v, s, i, n, used;
   float part[64];
   dn_result r;
   memset(f, 0, sizeof *f);
   want[0] = 0, want[1] = 3, want[2] = 0;
   if ((r = dn__shape_want(file, "template", 1, 2, want, DN__MOST, 0, &f->rest, err)) != DN_OK) return r;
   f->V = f->rest->shape[0];
   if ((r = dn__shape_want(file, "faces", 1, 2, want, DN__MOST, 1, &f->faces, err)) != DN_OK) return r;
   f->T = f->faces->shape[0];
   want[0] = f->V;
   if ((r = dn__shape_want(file, "shapedirs", 1, 3, want, DN_MAX_DIM, 0, &f->shapedirs, err)) != DN_OK) return r;
   f->B = f->shapedirs->shape[2];
   if ((r = dn__shape_want(file, "looseness_dirs", 0, 2, want, DN_MAX_DIM, 0, &f->looseness, err)) != DN_OK) return r;
   want[1] = 0;
   if ((r = dn__shape_want(file, "weights", 1, 2, want, DN_MAX_DIM, 0, &f->weights, err)) != DN_OK) return r;
   f->S = f->weights->shape[1];
   want[1] = 3, want[2] = dn__mul(9, f->S - 1);
   if (dn_tensors_find(file, "posedirs") && f->S < 2)
      return dn__fail(err, DN_BAD_SHAPE, dn__where_shape, SIZE_MAX, "posedirs: expected none, for weights has one joint");
   if ((r = dn__shape_want(file, "posedirs", 0, 3, want, DN_MAX_DIM, 0, &f->posedirs, err)) != DN_OK) return r;
   want[0] = f->S;
   if ((r = dn__shape_want(file, "parents", 0, 1, want, DN_MAX_DIM, 1, &f->parents, err)) != DN_OK) return r;
   want[2] = f->B;
   if ((r = dn__shape_want(file, "joint_template", 0, 2, want, DN_MAX_DIM, 0, &f->joint_rest, err)) != DN_OK) return r;
   if ((r = dn__shape_want(file, "joint_shapedirs", f->joint_rest != NULL, 3, want, DN_MAX_DIM, 0, &f->joint_shapedirs, err)) != DN_OK) return r;
   if (f->joint_shapedirs && !f->joint_rest) return dn__fail(err, DN_MISSING_TENSOR, dn__where_shape, SIZE_MAX, "joint_template: not in the file, which has joint_shapedirs");
   want[1] = f->V;
   if (!f->joint_rest && (r = dn__shape_want(file, "joint_regressor", 0, 2, want, DN__MOST, 0, &f->regressor, err)) != DN_OK) return r;
   if (f->regressor && f->S > f->V) /* what it gives must not outgrow the file */
      return dn__shape_fail(err, DN_BAD_SHAPE, "joint_regressor", SIZE_MAX, "found ", f->S, " joints, expected at most the ", f->V, " vertices");
   if ((r = dn__shape_finite(f->rest, err)) != DN_OK || (r = dn__shape_finite(f->shapedirs, err)) != DN_OK ||
       (r = dn__shape_finite(f->looseness, err)) != DN_OK || (r = dn__shape_finite(f->weights, err)) != DN_OK ||
       (r = dn__shape_finite(f->posedirs, err)) != DN_OK || (r = dn__shape_finite(f->joint_rest, err)) != DN_OK ||
       (r = dn__shape_finite(f->joint_shapedirs, err)) != DN_OK || (r = dn__shape_finite(f->regressor, err)) != DN_OK) return r;
   for (i = 0; i < 3 * f->T; i++) {
      int32_t at;
      dn_tensor_ints(f->faces, i, 1, &at);
      if (at < 0) return dn__shape_fail(err, DN_BAD_MESH, "faces", i / 3, "triangle ", i / 3, NULL, 0, " has a negative index");
      if ((size_t)at >= f->V) return dn__shape_fail(err, DN_BAD_MESH, "faces", i / 3, "found index ", (size_t)at, ", expected below ", f->V, NULL);
   }
   for (s = 0; f->parents && s < f->S; s++) {
      int32_t at;
      dn_tensor_ints(f->parents, s, 1, &at);
      if (at < -1 || (at >= 0 && (size_t)at >= s))
         return dn__shape_fail(err, DN_BAD_SKIN, "parents", s, "joint ", s, NULL, 0, ": expected -1 or a joint before it");
   }
   f->I = 1;
   for (v = 0; v < f->V; v++) {
      for (used = s = 0; s < f->S; s += n) {
         n = dn__min(f->S - s, 64);
         dn_tensor_floats(f->weights, v * f->S + s, n, part);
         for (i = 0; i < n; i++) used += part[i] > 0.0f;
      }
      f->I = dn__max(f->I, used);
   }
   f->names = dn_tensors_meta(file, "joint_names");
   return f->names ? dn__shape_names(f->names, f->S, NULL, 0, NULL, &f->names_bytes, err) : DN_OK;
}
static void dn__shape_layout(dn_shape *h, const dn__shape_file *f, dn__arena *a)
{
   dn_shape_view *v = &h->view;
   size_t rows = dn__mul(f->V, 3), joints = dn__mul(f->S, 3);
   int has_joints = f->joint_rest || f->regressor;
   v->rest = (float *)dn__take(a, rows, sizeof(float));
   v->triangle = (uint32_t *)dn__take(a, dn__mul(f->T, 3), sizeof(uint32_t));
   v->skin_joint = (uint32_t *)dn__take(a, dn__mul(f->V, f->I), sizeof(uint32_t));
   v->skin_weight = (float *)dn__take(a, dn__mul(f->V, f->I), sizeof(float));
   v->parents = f->parents ? (int32_t *)dn__take(a, f->S, sizeof(int32_t)) : NULL;
   v->joint_rest = has_joints ? (float *)dn__take(a, joints, sizeof(float)) : NULL;
   h->joint_shapedirs = has_joints ? (float *)dn__take(a, dn__mul(joints, f->B), sizeof(float)) : NULL;
   h->shapedirs = (float *)dn__take(a, dn__mul(rows, f->B), sizeof(float));
   h->posedirs = f->posedirs ? (float *)dn__take(a, f->posedirs->count, sizeof(float)) : NULL;
   h->looseness = f->looseness ? (float *)dn__take(a, rows, sizeof(float)) : NULL;
   v->joint_names = f->names ? (const char *const *)dn__take(a, f->S, sizeof(char *)) : NULL;
   h->text = f->names ? (char *)dn__take(a, dn__max(f->names_bytes, 1), 1) : NULL;
}
/* (V,3,C) -> (C,V,3) */
static void dn__shape_turn(const dn_tensor *t, size_t columns, float *out)
{
   size_t rows = t->count / columns, r, c, i, n;
   float part[64];
   for (r = 0; r < rows; r++)
      for (c = 0; c < columns; c += n) {
         n = dn__min(columns - c, 64);
         dn_tensor_floats(t, r * columns + c, n, part);
         for (i = 0; i < n; i++) out[(c + i) * rows + r] = part[i];
      }
}
static void dn__shape_skin(const dn__shape_file *f, uint32_t *joint, float *weight)
{
   size_t v, s, i, n, k;
   float part[64];
   for (v = 0; v < f->V; v++, joint += f->I, weight += f->I) {
      size_t used = 0;
      double sum = 0.0;
      for (s = 0; s < f->S; s += n) {
         n = dn__min(f->S - s, 64);
         dn_tensor_floats(f->weights, v * f->S + s, n, part);
         for (i = 0; i < n; i++) {
            if (!(part[i] > 0.0f)) continue;
            for (k = used++; k > 0 && weight[k - 1] < part[i]; k--) joint[k] = joint[k - 1], weight[k] = weight[k - 1];
            joint[k] = (uint32_t)(s + i);
            weight[k] = part[i];
            sum += (double)part[i];
         }
      }
      if (used == 0) joint[0] = 0, weight[0] = 1.0f, used = 1, sum = 1.0;
      for (k = 0; k < used; k++) weight[k] = (float)((double)weight[k] / sum);
      for (; k < f->I; k++) joint[k] = joint[0], weight[k] = 0.0f;
   }
}
/* joints = regressor v for the template and for every coefficient: linear in both, so it is done once */
static void dn__shape_regress(const dn__shape_file *f, const dn_shape *h, float *rest, float *dirs, double *sum)
{
   size_t s, v, i, n, b, k;
   float part[64];
   for (s = 0; s < f->S; s++) {
      for (i = 0; i < 3 * (f->B + 1); i++) sum[i] = 0.0;
      for (v = 0; v < f->V; v += n) {
         n = dn__min(f->V - v, 64);
         dn_tensor_floats(f->regressor, s * f->V + v, n, part);
         for (i = 0; i < n; i++) {
            if (part[i] == 0.0f) continue;
            for (k = 0; k < 3; k++) sum[k] += (double)part[i] * (double)h->view.rest[3 * (v + i) + k];
            for (b = 0; b < f->B; b++)
               for (k = 0; k < 3; k++) sum[3 * (b + 1) + k] += (double)part[i] * (double)h->shapedirs[3 * (b * f->V + v + i) + k];
         }
      }
      for (k = 0; k < 3; k++) rest[3 * s + k] = (float)sum[k];
      for (b = 0; b < f->B; b++)
         for (k = 0; k < 3; k++) dirs[3 * (b * f->S + s) + k] = (float)sum[3 * (b + 1) + k];
   }
}
static dn_result dn__shape_fill(dn_shape *h, const dn__shape_file *f, double *sum, dn_error *err)
{
   dn_shape_view *v = &h->view;
   size_t bytes;
   v->vertices = f->V;
   v->triangles = f->T;
   v->coefficients = f->B;
   v->joints = f->S;
   v->influences = f->I;
   v->has_looseness = f->looseness != NULL;
   v->has_pose_offsets = f->posedirs != NULL;
   h->pose_coefficients = f->posedirs ? 9 * (f->S - 1) : 0;
   dn_tensor_floats(f->rest, 0, f->rest->count, (float *)v->rest);
   dn_tensor_ints(f->faces, 0, f->faces->count, (int32_t *)v->triangle); /* none is negative */
   dn__shape_turn(f->shapedirs, f->B, (float *)h->shapedirs);
   if (f->posedirs) dn__shape_turn(f->posedirs, h->pose_coefficients, (float *)h->posedirs);
   if (f->looseness) dn_tensor_floats(f->looseness, 0, f->looseness->count, (float *)h->looseness);
   if (f->parents) dn_tensor_ints(f->parents, 0, f->S, (int32_t *)v->parents);
   dn__shape_skin(f, (uint32_t *)v->skin_joint, (float *)v->skin_weight);
   if (f->joint_rest) {
      dn_tensor_floats(f->joint_rest, 0, f->joint_rest->count, (float *)v->joint_rest);
      dn__shape_turn(f->joint_shapedirs, f->B, (float *)h->joint_shapedirs);
   } else if (f->regressor) dn__shape_regress(f, h, (float *)v->joint_rest, (float *)h->joint_shapedirs, sum);
   return f->names ? dn__shape_names(f->names, f->S, h->text, f->names_bytes, (const char **)v->joint_names, &bytes, err) : DN_OK;
}
static size_t dn__shape_bytes(const dn__shape_file *f, size_t *scratch)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn_shape h;
   memset(&h, 0, sizeof h);
   dn__take(&a, 1, sizeof(dn_shape));
   dn__shape_layout(&h, f, &a);
   *scratch = dn__max(DN__ALIGN, dn__mul(f->regressor ? dn__mul(dn__add(f->B, 1), 3) : 0, sizeof(double)));
   return a.used;
}
DN_API dn_result dn_shape_size(const dn_tensors *file, size_t *bytes, size_t *scratch, dn_error *err)
{
   dn__shape_file f;
   dn_result r;
   DN_ASSERT(file && bytes && scratch);
   *bytes = *scratch = 0;
   if ((r = dn__shape_open(file, &f, err)) != DN_OK) return r;
   *bytes = dn__shape_bytes(&f, scratch);
   return *bytes == SIZE_MAX || *scratch == SIZE_MAX ? dn__fail(err, DN_NO_MEMORY, dn__where_shape, SIZE_MAX, "sizes overflow") : DN_OK;
}
DN_API dn_result dn_shape_init(const dn_tensors *file, void *memory, size_t bytes, void *scratch, size_t scratch_bytes,
                               dn_shape **shape, dn_error *err)
{
   dn__shape_file f;
   dn__arena a = dn__arena_of(memory, bytes);
   size_t need, need_scratch;
   dn_shape *h;
   dn_result r;
   DN_ASSERT(file && memory && scratch && shape && ((uintptr_t)memory & 63) == 0 && ((uintptr_t)scratch & 63) == 0);
   *shape = NULL;
   if ((r = dn__shape_open(file, &f, err)) != DN_OK) return r;
   need = dn__shape_bytes(&f, &need_scratch);
   if (bytes < need) return dn__fail_sizes(err, DN_TOO_SMALL, dn__where_shape, SIZE_MAX, "memory: ", bytes, " bytes given, needed ", need, NULL);
   if (scratch_bytes < need_scratch)
      return dn__fail_sizes(err, DN_TOO_SMALL, dn__where_shape, SIZE_MAX, "scratch: ", scratch_bytes, " bytes given, needed ", need_scratch, NULL);
   h = (dn_shape *)dn__take(&a, 1, sizeof(dn_shape));
   memset(h, 0, sizeof *h);
   dn__shape_layout(h, &f, &a);
   h->view.bytes = a.used;
   if ((r = dn__shape_fill(h, &f, (double *)scratch, err)) != DN_OK) return r;
   *shape = h;
   return DN_OK;
}
DN_API dn_shape *dn_shape_load(const void *file, size_t size, const dn_allocator *allocator, dn_error *err)
{
   dn_tensors *tensors = NULL;
   dn_shape *shape = NULL;
   void *table, *memory = NULL, *scratch = NULL;
   size_t table_bytes = 0, bytes = 0, scratch_bytes = 0;
   if (dn_tensors_size(file, size, &table_bytes, err)) return NULL;
   table = dn__alloc(allocator, table_bytes);
   if (!table) {
      dn__fail_sizes(err, DN_NO_MEMORY, dn__where_shape, SIZE_MAX, "tensor table of ", table_bytes, NULL, 0, " bytes");
      return NULL;
   }
   if (!dn_tensors_open(file, size, table, table_bytes, &tensors, err) && !dn_shape_size(tensors, &bytes, &scratch_bytes, err)) {
      memory = dn__alloc(allocator, bytes);
      scratch = memory ? dn__alloc(allocator, scratch_bytes) : NULL;
      if (!scratch) dn__fail_sizes(err, DN_NO_MEMORY, dn__where_shape, SIZE_MAX, "shape of ", bytes, " bytes and scratch of ", scratch_bytes, " bytes");
      else dn_shape_init(tensors, memory, bytes, scratch, scratch_bytes, &shape, err);
   }
   dn__release(allocator, scratch, scratch_bytes);
   if (shape) {
      shape->owned = 1;
      shape->view.bytes = bytes; /* what free is told */
      if (allocator) shape->allocator_copy = *allocator, shape->allocator = &shape->allocator_copy;
   } else dn__release(allocator, memory, bytes);
   dn__release(allocator, table, table_bytes);
   return shape;
}
#ifndef DN_NO_STDIO
DN_API dn_shape *dn_shape_load_file(const char *path, const dn_allocator *allocator, dn_error *err)
{
   dn_shape *shape = NULL;
   FILE *f = fopen(path, "rb");
   size_t size = f ? dn__file_size(f) : SIZE_MAX;
   unsigned char *bytes = NULL;
   if (!f) dn__file_fail(err, DN_IO, path, "cannot open ");
   else if (size == SIZE_MAX) dn__file_fail(err, DN_IO, path, "cannot find the length of ");
   else if (size == 0) dn__file_fail(err, DN_TRUNCATED, path, "found 0 bytes, expected at least 8 in ");
   else if (!(bytes = (unsigned char *)dn__alloc(allocator, size))) dn__file_fail(err, DN_NO_MEMORY, path, "no memory for the bytes of ");
   else if (fread(bytes, 1, size, f) != size) dn__file_fail(err, DN_IO, path, "cannot read all of ");
   else shape = dn_shape_load(bytes, size, allocator, err);
   dn__release(allocator, bytes, size);
   if (f) fclose(f);
   return shape;
}
#endif
DN_API void dn_shape_free(dn_shape *shape)
{
   if (shape && shape->owned) {
      dn_allocator a = shape->allocator_copy; /* the copy inside goes with the memory */
      dn__release(shape->allocator ? &a : NULL, shape, shape->view.bytes);
   }
}
DN_API void dn_shape_describe(const dn_shape *shape, dn_shape_view *view) { *view = shape->view; }

/* out (+)= sum of scale_k dirs_k over the coefficients that are not 0, block by block so that out stays in the cache */
typedef struct dn__blend_job {
   size_t numbers, count;
   const float *base;          /* (numbers) or NULL: out as it is */
   const float *scale, *dirs;  /* (count), (count,numbers) */
   const float *minus;         /* (9) taken off every nine scales, or NULL: the identity, for pose offsets */
   const float *extra;         /* (numbers) or NULL, times extra_scale */
   float extra_scale, *out;
} dn__blend_job;
static void dn__blend_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__blend_job *j = (const dn__blend_job *)job;
   size_t block, k, i;
   (void)worker;
   for (block = begin; block < end; block++) {
      size_t from = block * DN__SHAPE_BLOCK, n = dn__min(DN__SHAPE_BLOCK, j->numbers - from);
      float *out = j->out + from;
      if (j->base) memcpy(out, j->base + from, n * sizeof *out);
      for (k = 0; k < j->count; k++) {
         float scale = j->minus ? j->scale[k] - j->minus[k % 9] : j->scale[k];
         const float *dir = j->dirs + k * j->numbers + from;
         if (scale == 0.0f) continue;
         for (i = 0; i < n; i++) out[i] += scale * dir[i];
      }
      if (j->extra && j->extra_scale != 0.0f)
         for (i = 0; i < n; i++) out[i] += j->extra_scale * j->extra[from + i];
   }
}
static void dn__blend(dn__blend_job *j, size_t numbers, const float *base, const float *scale, const float *dirs, size_t count,
                      float *out, const dn_parallel *parallel)
{
   j->numbers = numbers;
   j->base = base;
   j->scale = scale;
   j->dirs = dirs;
   j->count = count;
   j->out = out;
   dn__for(parallel, numbers / DN__SHAPE_BLOCK + (numbers % DN__SHAPE_BLOCK != 0), 4, dn__blend_range, j);
}
DN_API void dn_shape_evaluate(const dn_shape *shape, const float *beta, size_t count, float looseness, float *positions,
                              float *joints, const dn_parallel *parallel)
{
   const dn_shape_view *v = &shape->view;
   dn__blend_job j;
   DN_ASSERT(count <= v->coefficients && (count == 0 || beta) && (!joints || v->joint_rest));
   memset(&j, 0, sizeof j);
   if (joints) dn__blend(&j, 3 * v->joints, v->joint_rest, beta, shape->joint_shapedirs, count, joints, NULL);
   j.extra = shape->looseness;
   j.extra_scale = looseness;
   if (positions) dn__blend(&j, 3 * v->vertices, v->rest, beta, shape->shapedirs, count, positions, parallel);
}
DN_API void dn_shape_pose_offsets(const dn_shape *shape, const float *rotations, float *positions, const dn_parallel *parallel)
{
   static const float identity[9] = { 1.0f, 0.0f, 0.0f, 0.0f, 1.0f, 0.0f, 0.0f, 0.0f, 1.0f };
   dn__blend_job j;
   if (!shape->posedirs) return;
   memset(&j, 0, sizeof j);
   j.minus = identity;
   dn__blend(&j, 3 * shape->view.vertices, NULL, rotations + 9, shape->posedirs, shape->pose_coefficients, positions, parallel);
}
/* ===================================================================================== >>garment
   in       a body with skin, a garment, their models; each frame a palette     out   dn_garment; positions (V,3)
   touches  bind and change: the garment's memory and scratch; a frame: its scratch and the caller's output arrays
   paper    association T 4.3, C 4.1; relative feature of a garment T 4.7; coarse and refined garment T 4.2, 4.3, C 4
   flow     bind: both meshes checked and welded as in >>rig -> joints of each model -> association -> rest-pose clusters
            frame: dn_garment_stage_follow -> _coarse -> _refine -> _output
   read     dn__garment_seat (what garment and body have to do with each other), then the four stages */

typedef struct dn__binding { /* one model's joints in this skeleton */
   const uint32_t *map;      /* (S_model) */
   const uint32_t *fold;     /* (S) or NULL, as in dn_rig */
   const float *joint_rest;  /* (S_model,3) */
   uint32_t root;
} dn__binding;

struct dn_garment {
   const dn_model *model[2];      /* coarse, refine; either may be NULL */
   dn__binding joints[2];
   dn_garment_view view;
   dn_allocator allocator;
   const dn_allocator *allocator_used; /* NULL: DN_MALLOC, or &allocator */
   int owned;
   size_t bandwidth;                   /* the largest |i - j| over the edges of the graph */
   int wants_clusters, has_clusters;   /* "rest" pooling */
   int spread;                         /* vertices of a node rest apart: see dn__garment_vertex */
   int has_coarse_rest;
   const float *rest_vertices;         /* (V,3) */
   const float *anchor;                /* (N,3) the associated body node at rest */
   const float *coarse_rest;           /* (N,3) */
   const uint32_t *corner_first, *corner_tri; /* triangles at each garment node */
   const uint32_t *body_skin_joint;    /* (body nodes,I) */
   const float *body_skin_weight;
   const uint32_t *body_triangle, *body_corner_first, *body_corner_tri;
   dn_clusters clusters[2];            /* of the direction and the length branch */
};

/* --- the frame's scratch */
typedef struct dn__wear {
   float *palette;             /* (S,12) model space */
   float *seen;                /* (S,12) what the stage's network sees: its frame, extra joints folded */
   float *posed;               /* (3, S_model rounded up) joints in that frame */
   float *root;                /* (9) rotation of that frame */
   float *base, *base_low;     /* (N,3) the associated body node, posed, model space; what float leaves of it */
   float *followed, *coarse, *coarse_displacement, *displacement, *refined; /* (N,3) model space, see dn_garment_nodes */
   double *framed;             /* (N,3) positions in the network's frame, as in dn__frame */
   float *delta;               /* (N,3) coarse displacement in that frame */
   float *normals;             /* (N,3) */
   double *body;               /* (body nodes,3) in the coarse network's frame, where it reads normals */
   float *body_normals;
   float *rows;                /* (N,D) */
   unsigned char *fell;        /* (N) a network was not finite here */
   uint32_t *state;            /* (1) the palette is finite */
   dn__net net[2];             /* one after the other in the same memory */
} dn__wear;

static int dn__stage_reads(const dn__stage *s, dn_feature feature)
{
   size_t k;
   for (k = 0; k < s->feature_count; k++)
      if (s->features[k] == feature) return 1;
   return 0;
}
/* which of a model's stages runs as stage k of a garment: clothnet has both, the others one */
static const dn__stage *dn__garment_stage(const dn_model *m, size_t k) { return &m->stage[m->info.arch == DN_CLOTHNET ? k : 0]; }
static int dn__reads_body_normals(const dn_model *coarse) { return coarse && dn__stage_reads(dn__garment_stage(coarse, 0), DN_NORMAL); }

typedef struct dn__wear_sizes { size_t nodes, neighbours, bandwidth, body_nodes, joints; } dn__wear_sizes;
static void dn__wear_layout(dn__wear *f, const dn_model *const model[2], const dn__wear_sizes *s,
                            const dn_clusters *rest, unsigned workers, dn__arena *a)
{
   size_t k, N3 = dn__mul(s->nodes, 3), B3, joints = 0, width = 0, from, most;
   dn__extent e;
   memset(f, 0, sizeof *f);
   for (k = 0; k < 2; k++)
      if (model[k]) {
         joints = dn__max(joints, model[k]->info.joints);
         width = dn__max(width, dn__garment_stage(model[k], k)->row_width);
      }
   f->palette = (float *)dn__take(a, dn__mul(s->joints, 12), sizeof(float));
   f->seen = (float *)dn__take(a, dn__mul(s->joints, 12), sizeof(float));
   f->posed = (float *)dn__take(a, dn__mul(dn__posed_pitch(joints), 3), sizeof(float));
   f->root = (float *)dn__take(a, 9, sizeof(float));
   f->base = (float *)dn__take(a, N3, sizeof(float));
   f->base_low = (float *)dn__take(a, N3, sizeof(float));
   f->followed = (float *)dn__take(a, N3, sizeof(float));
   f->coarse = (float *)dn__take(a, N3, sizeof(float));
   f->coarse_displacement = (float *)dn__take(a, N3, sizeof(float));
   f->displacement = (float *)dn__take(a, N3, sizeof(float));
   f->refined = (float *)dn__take(a, dn__add(N3, 1), sizeof(float));
   f->framed = (double *)dn__take(a, dn__add(N3, 1), sizeof(double)); /* here and below one to load past the end */
   f->delta = (float *)dn__take(a, N3, sizeof(float));
   f->normals = (float *)dn__take(a, N3, sizeof(float));
   f->fell = (unsigned char *)dn__take(a, s->nodes, 1);
   f->state = (uint32_t *)dn__take(a, 1, sizeof(uint32_t));
   f->rows = (float *)dn__take(a, dn__mul(s->nodes, width), sizeof(float));
   B3 = dn__mul(dn__reads_body_normals(model[0]) ? s->body_nodes : 0, 3);
   e = dn__extent_of(s->nodes, s->neighbours, s->bandwidth); /* of no contraction: dn_garment_change finds others */
   from = most = a->used;
   f->body = (double *)dn__take(a, dn__add(B3, 1), sizeof(double));
   f->body_normals = (float *)dn__take(a, B3, sizeof(float));
   most = a->used;
   for (k = 0; k < 2; k++) { /* the posed body is not needed once the rows are written, a stage not once the next begins */
      a->used = from;
      e.rest = k == 1 ? rest : NULL;
      if (model[k])
         dn__garment_net_layout(&f->net[k], model[k], model[k]->info.arch == DN_CLOTHNET ? k : 0, &e, workers, a);
      most = dn__max(most, a->used);
   }
   a->used = most;
}
static dn__wear_sizes dn__wear_sizes_of(const dn_garment *g)
{
   dn__wear_sizes s;
   s.nodes = g->view.nodes;
   s.neighbours = g->view.graph.first[g->view.nodes];
   s.bandwidth = g->bandwidth;
   s.body_nodes = g->view.body_nodes;
   s.joints = g->view.joints;
   return s;
}
static size_t dn__wear_bytes(const dn_model *const model[2], const dn__wear_sizes *s, const dn_clusters *rest,
                             unsigned workers)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn__wear f;
   dn__wear_layout(&f, model, s, rest, workers, &a);
   return a.used;
}
static dn__wear dn__wear_of(const dn_garment *g, void *scratch, unsigned workers)
{
   dn__arena a = dn__arena_of(scratch, SIZE_MAX / 2);
   dn__wear_sizes s = dn__wear_sizes_of(g);
   dn__wear f;
   dn__wear_layout(&f, g->model, &s, g->has_clusters ? g->clusters : NULL, workers, &a);
   return f;
}
DN_API size_t dn_garment_scratch_size(const dn_garment *g, unsigned workers)
{
   dn__wear_sizes s = dn__wear_sizes_of(g);
   return dn__wear_bytes(g->model, &s, g->has_clusters ? g->clusters : NULL, workers ? workers : 1);
}
DN_API void *dn_garment_scratch_create(const dn_garment *g, unsigned workers, const dn_allocator *allocator,
                                       size_t *bytes, dn_error *err)
{
   void *scratch;
   DN_ASSERT(g && bytes);
   *bytes = dn_garment_scratch_size(g, workers);
   scratch = dn__alloc(allocator, *bytes);
   if (!scratch)
      dn__fail_sizes(err, DN_NO_MEMORY, "garment frame", SIZE_MAX, "scratch of ", *bytes, NULL, 0, " bytes");
   return scratch;
}
DN_API dn_garment_nodes dn_garment_nodes_of(const dn_garment *g, void *scratch)
{
   dn__wear f = dn__wear_of(g, scratch, 1); /* the workers do not move what lies before the network's buffers */
   dn_garment_nodes n;
   n.followed = f.followed;
   n.coarse = f.coarse;
   n.coarse_displacement = f.coarse_displacement;
   n.displacement = f.displacement;
   n.refined = f.refined;
   return n;
}

/* --- stage 1: follow the body */
typedef struct dn__wear_job {
   const dn_garment *g;
   const dn__wear *f;
   const dn_garment_pose *pose;
   const dn__stage *stage;
   size_t k;                 /* 0 coarse, 1 refine */
   dn_garment_output *out;
   float strength;
} dn__wear_job;
static void dn__split(const double p[3], float *high, float *low)
{
   int k;
   for (k = 0; k < 3; k++) {
      high[k] = (float)p[k];
      low[k] = (float)(p[k] - (double)high[k]);
   }
}
/* a posed body node: as given, or LBS of its rest position; node n of `rest` with skin row n of joint and weight */
static void dn__body_point(const dn__wear_job *j, size_t body_node, const float *rest, const uint32_t *joint,
                           const float *weight, double p[3])
{
   const dn_garment_view *v = &j->g->view;
   if (j->pose->body) {
      float q[3];
      int k;
      memcpy(q, (const unsigned char *)j->pose->body + v->body_first_vertex[body_node] * dn__stride(j->pose->body_stride, 12), 12);
      for (k = 0; k < 3; k++) p[k] = (double)q[k];
   } else dn__lbs_point(joint, weight, v->influences, j->f->palette, rest, p);
}
static void dn__follow_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__wear_job *j = (const dn__wear_job *)job;
   const dn_garment_view *v = &j->g->view;
   const dn__wear *f = j->f;
   size_t i, k;
   (void)worker;
   for (i = begin; i < end; i++) {
      const uint32_t *joint = v->skin_joint + i * v->influences;
      const float *weight = v->skin_weight + i * v->influences, *anchor = j->g->anchor + 3 * i;
      double m[12], base[3], own[3], skinned[3];
      dn__lbs_blend_double(joint, weight, v->influences, f->palette, m);
      dn__transform_double(m, v->rest + 3 * i, own);
      dn__body_point(j, v->body_node[i], anchor, joint, weight, base);
      if (j->pose->body) { /* where the body is not where LBS puts it, the garment goes along */
         dn__transform_double(m, anchor, skinned);
         for (k = 0; k < 3; k++) own[k] += base[k] - skinned[k];
      }
      dn__split(base, f->base + 3 * i, f->base_low + 3 * i);
      for (k = 0; k < 3; k++) f->followed[3 * i + k] = (float)own[k];
   }
}
DN_API dn_result dn_garment_stage_follow(const dn_garment *g, const dn_garment_pose *pose, void *scratch,
                                         size_t scratch_bytes, const dn_parallel *parallel, dn_error *err)
{
   dn__wear f;
   dn__wear_job job;
   size_t s, floats, need = dn_garment_scratch_size(g, dn__workers(parallel));
   DN_ASSERT(pose && pose->palette && scratch && ((uintptr_t)scratch & 63) == 0);
   if (scratch_bytes < need)
      return dn__fail_sizes(err, DN_TOO_SMALL, "garment frame", SIZE_MAX, "scratch: ", scratch_bytes,
                            " bytes given, needed ", need, NULL);
   f = dn__wear_of(g, scratch, dn__workers(parallel));
   floats = dn__matrix_floats(pose->matrix);
   *f.state = 1;
   memset(f.fell, 0, g->view.nodes);
   for (s = 0; s < g->view.joints; s++) {
      dn__load_matrix(pose->palette + floats * s, pose->matrix, f.palette + 12 * s);
      *f.state &= (uint32_t)dn__finite12(f.palette + 12 * s);
   }
   memset(&job, 0, sizeof job);
   job.g = g;
   job.f = &f;
   job.pose = pose;
   dn__for(parallel, g->view.nodes, 512, dn__follow_range, &job);
   return DN_OK;
}

/* --- what both networks read */
/* The posed body in the network's frame: the coarse stage takes its normals */
static void dn__body_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__wear_job *j = (const dn__wear_job *)job;
   const dn_garment *g = j->g;
   size_t i, I = g->view.influences;
   (void)worker;
   for (i = begin; i < end; i++) {
      double p[3];
      dn__body_point(j, i, g->view.body_rest + 3 * i, g->body_skin_joint + I * i, g->body_skin_weight + I * i, p);
      dn__unrotate(j->f->root, p, j->f->body + 3 * i);
   }
}
static void dn__body_normals_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__wear_job *j = (const dn__wear_job *)job;
   (void)worker;
   dn__normals_fine_run(j->g->model[0]->info.kernel, j->f->body, j->g->body_triangle, j->g->body_corner_first,
                        j->g->body_corner_tri, begin, end, j->f->body_normals);
}
/* positions in the network's frame: the body node in the coarse stage, M_coarse in the refining one */
static void dn__garment_framed_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__wear_job *j = (const dn__wear_job *)job;
   const dn__wear *f = j->f;
   size_t i, k;
   (void)worker;
   for (i = 3 * begin; i < 3 * end; i += 3) {
      double p[3], d[3], x[3];
      for (k = 0; k < 3; k++) {
         d[k] = j->k == 0 ? 0.0 : (double)f->coarse_displacement[i + k];
         p[k] = (double)f->base[i + k] + (double)f->base_low[i + k] + d[k];
      }
      dn__unrotate(f->root, p, f->framed + i);
      dn__unrotate(f->root, d, x);
      for (k = 0; k < 3; k++) f->delta[i + k] = (float)x[k];
   }
}
static void dn__garment_rows_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__wear_job *j = (const dn__wear_job *)job;
   const dn_garment *g = j->g;
   const dn_garment_view *v = &g->view;
   const dn__wear *f = j->f;
   size_t i, k, c, D = j->stage->row_width, joints = g->model[j->k]->info.joints;
   dn_kernel kernel = g->model[j->k]->info.kernel;
   float *rows = f->rows;
   (void)worker;
   if (j->k == 1)
      dn__normals_fine_run(kernel, f->framed, v->triangle, g->corner_first, g->corner_tri, begin, end, f->normals);
   for (k = 0; k < j->stage->feature_count; k++) {
      switch (j->stage->features[k]) {
      case DN_POSITION: dn__rows_position(f->framed, begin, end, rows, D); rows += 3; break;
      case DN_RELATIVE: /* r_b', in the refining stage r_b' + Delta_coarse                              T 4.7 */
         dn__rows_relative_run(kernel, g->anchor, v->skin_joint, v->skin_weight, v->influences, NULL, f->seen, begin, end,
                               rows, D);
         for (i = begin; i < end && j->k == 1; i++)
            for (c = 0; c < 3; c++) rows[i * D + c] += f->delta[3 * i + c];
         rows += 3;
         break;
      case DN_NORMAL:
         if (j->k == 1) dn__rows_normal(f->normals, begin, end, rows, D);
         else
            for (i = begin; i < end; i++) memcpy(rows + i * D, f->body_normals + 3 * (size_t)v->body_node[i], 12);
         rows += 3;
         break;
      case DN_DISTANCE:
         dn__rows_distance_run(kernel, f->framed, f->posed, joints, begin, end, rows, D);
         rows += joints;
         break;
      case DN_FIT:
         for (i = begin; i < end; i++) memcpy(rows + i * D, v->alpha, j->stage->fit * sizeof *rows);
         rows += j->stage->fit;
         break;
      case DN_GEODESIC: /* refused by the loader: a garment is not solid */
      default: break;
      }
   }
}
typedef struct dn__normalise_job { const dn__stage *stage; dn_kernel kernel; float *rows; } dn__normalise_job;
static void dn__normalise_job_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__normalise_job *j = (const dn__normalise_job *)job;
   const dn__stage *s = j->stage;
   (void)worker;
   dn__normalise_run(j->kernel, s->input_mean, s->input_scale, s->input_rest, s->row_width, j->rows, begin, end);
}
static void dn__normalise(const dn__stage *stage, dn_kernel kernel, float *rows, size_t nodes, const dn_parallel *parallel)
{
   dn__normalise_job job;
   job.stage = stage;
   job.kernel = kernel;
   job.rows = rows;
   if (stage->input_mean) dn__for(parallel, nodes, 512, dn__normalise_job_range, &job);
}
/* Stage k's network, up to displacements in model space; with `found` no further than its pools */
static void dn__garment_network(const dn_garment *g, const dn__wear *f, const dn_garment_pose *pose, size_t k,
                                float *displacement, const dn_parallel *parallel, const dn_probe *probe,
                                dn_clusters *found)
{
   const dn_model *m = g->model[k];
   const dn__stage *stage = dn__garment_stage(m, k);
   const dn__binding *at = &g->joints[k];
   size_t s, nodes = g->view.nodes, D = stage->row_width;
   dn__wear_job job;
   dn__run run;
   for (s = 0; s < 9; s++) f->root[s] = s % 4 == 0 ? 1.0f : 0.0f;
   if (m->info.root_frame) dn__root_rotation(f->palette + 12 * (size_t)at->root, f->root);
   for (s = 0; s < g->view.joints; s++)
      dn__root_palette(f->palette + 12 * (size_t)(at->fold ? at->fold[s] : (uint32_t)s), 1, f->root,
                       f->seen + 12 * s);
   dn__posed_joints(f->seen, at->map, at->joint_rest, m->info.joints, f->posed);
   memset(&job, 0, sizeof job);
   job.g = g;
   job.f = f;
   job.pose = pose;
   job.stage = stage;
   job.k = k;
   if (k == 0 && dn__stage_reads(stage, DN_NORMAL)) {
      dn__for(parallel, g->view.body_nodes, 512, dn__body_range, &job);
      dn__for(parallel, g->view.body_nodes, 512, dn__body_normals_range, &job);
   }
   dn__for(parallel, nodes, 1024, dn__garment_framed_range, &job);
   dn__for(parallel, nodes, 512, dn__garment_rows_range, &job);

   run.m = m;
   run.stage = stage;
   run.g = &g->view.graph;
   run.n = &f->net[k];
   run.par = parallel;
   run.probe = probe;
   run.found = found;
   run.start = NULL;
   dn__tap(&run, m->info.arch != DN_CLOTHNET ? "features" : k == 0 ? "coarse.features" : "detail.features", f->rows,
           0, nodes, D, D);
   if (run.n->shape) { /* beta, theta, alpha (T 4.3); alpha, beta, theta (C 4.3) */
      const dn_garment_view *v = &g->view;
      int cloth = m->info.arch == DN_CLOTHNET;
      float *alpha = run.n->shape + (cloth ? 0 : v->betas + v->thetas);
      float *beta = run.n->shape + (cloth ? v->alphas : 0);
      float *theta = beta + v->betas;
      if (v->alphas) memcpy(alpha, v->alpha, v->alphas * sizeof *alpha);
      if (v->betas) memcpy(beta, v->beta, v->betas * sizeof *beta);
      if (v->thetas && pose->theta) memcpy(theta, pose->theta, v->thetas * sizeof *theta);
      else memset(theta, 0, v->thetas * sizeof *theta);
   }
   dn__normalise(stage, m->info.kernel, f->rows, nodes, parallel); /* after the tap, which sees the rows as they are */
   dn__run_garment(&run, f->rows, displacement);
   if (!found) dn__displace(stage, f->root, displacement, nodes, NULL, parallel);
}
static int dn__finite3(const float *p) { return dn__finite(p[0]) & dn__finite(p[1]) & dn__finite(p[2]); }

/* --- stage 2: M_coarse = I M_b + Delta_coarse */
static void dn__coarse_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__wear_job *j = (const dn__wear_job *)job;
   const dn__wear *f = j->f;
   size_t i, k;
   int own = !j->pose->coarse_displacement && !j->g->model[0]; /* neither network nor caller: what was followed */
   (void)worker;
   for (i = begin; i < end; i++) {
      float *d = f->coarse_displacement + 3 * i;
      if (j->pose->coarse_displacement) memcpy(d, j->pose->coarse_displacement + 3 * i, 12);
      for (k = 0; k < 3 && !own; k++) f->coarse[3 * i + k] = f->base[3 * i + k] + d[k];
      if (!own && dn__finite3(d) && dn__finite3(f->coarse + 3 * i)) continue;
      f->fell[i] |= (unsigned char)!own;
      memcpy(f->coarse + 3 * i, f->followed + 3 * i, 12); /* the worst case is always the garment that follows */
      for (k = 0; k < 3; k++) d[k] = f->followed[3 * i + k] - f->base[3 * i + k];
   }
}
DN_API void dn_garment_stage_coarse(const dn_garment *g, const dn_garment_pose *pose, void *scratch,
                                    const dn_parallel *parallel, const dn_probe *probe)
{
   dn__wear f = dn__wear_of(g, scratch, dn__workers(parallel));
   dn__wear_job job;
   memset(&job, 0, sizeof job);
   job.g = g;
   job.f = &f;
   job.pose = pose;
   if (g->model[0] && !pose->coarse_displacement)
      dn__garment_network(g, &f, pose, 0, f.coarse_displacement, parallel, probe, NULL);
   dn__for(parallel, g->view.nodes, 1024, dn__coarse_range, &job);
}

/* --- stage 3: M = M_coarse + Delta, and the strength */
static float dn__toward(float from, float to, float amount) { return amount >= 1.0f ? to : from + amount * (to - from); }
static void dn__refine_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__wear_job *j = (const dn__wear_job *)job;
   const dn__wear *f = j->f;
   size_t i, k;
   (void)worker;
   for (i = begin; i < end; i++) {
      float *d = f->displacement + 3 * i, to[3];
      for (k = 0; k < 3; k++) to[k] = f->coarse[3 * i + k] + d[k];
      if (!dn__finite3(to)) { /* of a displacement that is not, or that is too large to add */
         f->fell[i] = 1;
         d[0] = d[1] = d[2] = 0.0f;
         memcpy(to, f->coarse + 3 * i, sizeof to);
      }
      for (k = 0; k < 3; k++) f->refined[3 * i + k] = dn__toward(f->followed[3 * i + k], to[k], j->strength);
   }
}
DN_API void dn_garment_stage_refine(const dn_garment *g, const dn_garment_pose *pose, void *scratch,
                                    const dn_parallel *parallel, const dn_probe *probe)
{
   dn__wear f = dn__wear_of(g, scratch, dn__workers(parallel));
   dn__wear_job job;
   memset(&job, 0, sizeof job);
   job.g = g;
   job.f = &f;
   job.pose = pose;
   job.strength = dn__unit_clamp(pose->strength);
   if (g->model[1]) dn__garment_network(g, &f, pose, 1, f.displacement, parallel, probe, NULL);
   else memset(f.displacement, 0, 3 * g->view.nodes * sizeof *f.displacement);
   dn__for(parallel, g->view.nodes, 1024, dn__refine_range, &job);
}

/* --- stage 4: out to the caller. A vertex that rests beside its node (welded over a distance) keeps its place in the
   node's blended frame. */
static void dn__garment_vertex(const dn__wear_job *j, const float *nodes, size_t v, float p[3])
{
   const dn_garment_view *view = &j->g->view;
   size_t i = view->node_of_vertex[v], k;
   memcpy(p, nodes + 3 * i, 12);
   if (j->g->spread) {
      double m[12], x[3];
      float beside[3];
      for (k = 0; k < 3; k++) beside[k] = j->g->rest_vertices[3 * v + k] - view->rest[3 * i + k];
      dn__lbs_blend_double(view->skin_joint + i * view->influences, view->skin_weight + i * view->influences,
                           view->influences, j->f->palette, m);
      m[3] = m[7] = m[11] = 0.0;
      dn__transform_double(m, beside, x);
      for (k = 0; k < 3; k++) p[k] += (float)x[k];
   }
}
static void dn__garment_output_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__wear_job *j = (const dn__wear_job *)job;
   dn_garment_output *o = j->out;
   size_t v;
   (void)worker;
   for (v = begin; v < end; v++) {
      size_t i = j->g->view.node_of_vertex[v];
      float p[3];
      if (o->positions) {
         dn__garment_vertex(j, j->f->refined, v, p);
         memcpy(dn__strided(o->positions, dn__stride(o->position_stride, 12), v), p, 12);
      }
      if (o->coarse) {
         dn__garment_vertex(j, j->f->coarse, v, p);
         memcpy(dn__strided(o->coarse, dn__stride(o->coarse_stride, 12), v), p, 12);
      }
      if (o->displacement)
         memcpy(dn__strided(o->displacement, dn__stride(o->displacement_stride, 12), v), j->f->displacement + 3 * i,
                12);
      if (o->normals) memcpy(dn__strided(o->normals, dn__stride(o->normal_stride, 12), v), j->f->normals + 3 * i, 12);
   }
}
static void dn__garment_normals_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__wear_job *j = (const dn__wear_job *)job;
   const dn_model *m = j->g->model[1] ? j->g->model[1] : j->g->model[0];
   dn__normals_run(m ? m->info.kernel : DN_KERNEL_AUTO, j->f->refined, j->g->view.triangle, j->g->corner_first,
                   j->g->corner_tri, begin, end, j->f->normals);
   (void)worker;
}
DN_API dn_result dn_garment_stage_output(const dn_garment *g, const dn_garment_pose *pose, dn_garment_output *out,
                                         void *scratch, const dn_parallel *parallel, dn_error *err)
{
   dn__wear f = dn__wear_of(g, scratch, dn__workers(parallel));
   dn__wear_job job;
   size_t i, k;
   DN_ASSERT(out && pose);
   memset(&job, 0, sizeof job);
   job.g = g;
   job.f = &f;
   job.pose = pose;
   job.out = out;
   if (out->normals) dn__for(parallel, g->view.nodes, 512, dn__garment_normals_range, &job);
   dn__for(parallel, g->view.vertices, 1024, dn__garment_output_range, &job);
   for (k = 0; k < 3; k++) {
      out->bounds_min[k] = 3.402823466e38f;
      out->bounds_max[k] = -3.402823466e38f;
   }
   for (i = 0; i < (g->spread ? g->view.vertices : g->view.nodes); i++) {
      float p[3];
      if (g->spread) dn__garment_vertex(&job, f.refined, i, p);
      else memcpy(p, f.refined + 3 * i, 12);
      for (k = 0; k < 3; k++) {
         if (p[k] < out->bounds_min[k]) out->bounds_min[k] = p[k];
         if (p[k] > out->bounds_max[k]) out->bounds_max[k] = p[k];
      }
   }
   out->fallback_nodes = 0;
   for (i = 0; i < g->view.nodes; i++) out->fallback_nodes += f.fell[i];
   if (out->fallback_nodes == 0 && *f.state) return DN_OK;
   return dn__fail_sizes(err, DN_NOT_FINITE, "garment frame", SIZE_MAX, *f.state
                         ? "nodes that took the step before: "
                         : "the palette is not finite; nodes that took the step before: ", out->fallback_nodes,
                         " of ", g->view.nodes, NULL);
}
DN_API dn_result dn_garment_deform(const dn_garment *g, const dn_garment_pose *pose, dn_garment_output *out,
                                   void *scratch, size_t scratch_bytes, const dn_parallel *parallel, dn_error *err)
{
   dn_result r = dn_garment_stage_follow(g, pose, scratch, scratch_bytes, parallel, err);
   if (r != DN_OK) return r;
   dn_garment_stage_coarse(g, pose, scratch, parallel, NULL);
   dn_garment_stage_refine(g, pose, scratch, parallel, NULL);
   return dn_garment_stage_output(g, pose, out, scratch, parallel, err);
}

/* --- bind: two meshes through the same steps as a rig's, then what lies between them */
typedef struct dn__tailor {
   const dn_garment_desc *desc;
   const dn_model *model[2];
   dn_error *err;
   dn_rig_desc body_desc, garment_desc;
   dn__bind body, garment;
   dn_garment_report report;
   void *work;                /* of dn__garment_seat and dn__garment_renew */
   size_t work_bytes;
} dn__tailor;
static const char dn__where_garment[] = "garment bind";

static dn_result dn__garment_numbers(const float *x, size_t count, const char *name, dn_error *err)
{
   size_t i;
   for (i = 0; i < count; i++)
      if (!dn__finite(x[i]))
         return dn__fail_sizes(err, DN_BAD_VALUE, dn__where_garment, i, name, i, NULL, 0, " is not finite");
   return DN_OK;
}
static dn_result dn__garment_model(const dn__tailor *t, size_t k)
{
   const dn_garment_desc *d = t->desc;
   const dn_model *m = t->model[k];
   dn_arch kind = k == 0 ? DN_GARFIT_COARSE : DN_GARFITNET;
   const dn__stage *stage;
   char line[240];
   dn__text text = dn__text_of(line, sizeof line);
   if (!m) return DN_OK;
   if (m->info.arch != kind && m->info.arch != DN_CLOTHNET) {
      dn__put(&text, k == 0 ? "coarse: the model is of the kind " : "refine: the model is of the kind ");
      dn__put(&text, m->info.arch_name);
      dn__put(&text, k == 0 ? ", expected garfit_coarse or clothnet" : ", expected garfitnet or clothnet");
      return dn__fail(t->err, DN_UNSUPPORTED, dn__where_garment, SIZE_MAX, line);
   }
   stage = dn__garment_stage(m, k);
   if (stage->fit > d->alphas)
      return dn__fail_sizes(t->err, DN_BAD_SHAPE, dn__where_garment, SIZE_MAX, "alphas: found ", d->alphas,
                            ", the model's feature fit reads ", stage->fit, NULL);
   if (k == 1 && dn__add(dn__add(d->alphas, d->betas), d->thetas) != m->info.parser) {
      dn__put(&text, "alphas + betas + thetas: found ");
      dn__put_size(&text, d->alphas);
      dn__put(&text, " + ");
      dn__put_size(&text, d->betas);
      dn__put(&text, " + ");
      dn__put_size(&text, d->thetas);
      dn__put(&text, ", the model reads ");
      dn__put_size(&text, m->info.parser);
      return dn__fail(t->err, DN_BAD_SHAPE, dn__where_garment, SIZE_MAX, line);
   }
   return DN_OK;
}
static dn_result dn__tailor_open(dn__tailor *t, const dn_garment_desc *d, dn_error *err)
{
   dn_result r;
   memset(t, 0, sizeof *t);
   t->desc = d;
   t->err = err;
   t->model[0] = d->coarse ? d->coarse : d->refine && d->refine->info.arch == DN_CLOTHNET ? d->refine : NULL;
   t->model[1] = d->refine;
   t->body_desc.mesh = d->body;
   t->body_desc.skeleton = d->skeleton;
   t->garment_desc.mesh = d->garment;
   t->body_desc.weld_distance = t->garment_desc.weld_distance = d->weld_distance;
   t->body_desc.parallel = t->garment_desc.parallel = d->parallel;
   t->body_desc.progress = t->garment_desc.progress = d->progress;
   if ((r = dn__bind_open(&t->body, NULL, &t->body_desc, "garment bind: body", 0, err)) != DN_OK) return r;
   if ((r = dn__bind_open(&t->garment, NULL, &t->garment_desc, "garment bind: garment", 1, err)) != DN_OK) return r;
   if (d->alphas > DN_MAX_DIM || d->betas > DN_MAX_DIM || d->thetas > DN_MAX_DIM)
      return dn__fail_sizes(err, DN_BAD_SHAPE, dn__where_garment, SIZE_MAX, "alphas, betas, thetas: found ",
                            dn__max(d->alphas, dn__max(d->betas, d->thetas)), ", expected at most ", DN_MAX_DIM,
                            NULL);
   DN_ASSERT((d->alphas == 0 || d->alpha) && (d->betas == 0 || d->beta));
   if ((r = dn__garment_numbers(d->alpha, d->alphas, "alpha ", err)) != DN_OK) return r;
   if ((r = dn__garment_numbers(d->beta, d->betas, "beta ", err)) != DN_OK) return r;
   if ((r = dn__garment_model(t, 0)) != DN_OK) return r;
   return dn__garment_model(t, 1);
}
static int dn__tailor_wants_clusters(const dn__tailor *t) { return t->model[1] && t->model[1]->info.pooling == DN_POOL_REST; }
/* scratch of dn__garment_seat, then of dn__garment_renew: the network up to its pools on the rest pose */
static size_t dn__renew_bytes(const dn_model *const model[2], const dn__wear_sizes *s, int wants_clusters,
                              unsigned workers)
{
   size_t frame = wants_clusters ? dn__add(dn__round(dn__mul(s->joints, 12 * sizeof(float)), DN__ALIGN),
                                           dn__wear_bytes(model, s, NULL, workers)) : 0;
   return dn__max(frame, dn_associate_scratch(s->body_nodes));
}
static void dn__tailor_memory(dn__tailor *t, dn__arena *a)
{
   dn__wear_sizes s;
   dn__bind_memory(&t->body, a);
   dn__bind_memory(&t->garment, a);
   s.nodes = t->garment.vertices;
   s.neighbours = dn__mul(t->garment.triangles, 6);
   s.bandwidth = SIZE_MAX; /* any other needs no more */
   s.body_nodes = t->body.vertices;
   s.joints = t->body.joints;
   t->work_bytes = dn__renew_bytes(t->model, &s, dn__tailor_wants_clusters(t), dn__workers(t->desc->parallel));
   t->work = dn__take(a, t->work_bytes, 1);
}
typedef struct dn__garment_sizes { size_t nodes, neighbours, kept, body_nodes, body_kept; } dn__garment_sizes;
static dn__garment_sizes dn__garment_bounds(const dn__tailor *t)
{
   dn__garment_sizes s;
   s.nodes = t->garment.vertices;
   s.neighbours = dn__mul(t->garment.triangles, 6);
   s.kept = t->garment.triangles;
   s.body_nodes = t->body.vertices;
   s.body_kept = t->body.triangles;
   return s;
}
static dn__garment_sizes dn__garment_exact(const dn__tailor *t)
{
   dn__garment_sizes s;
   s.nodes = t->garment.nodes;
   s.neighbours = t->garment.neighbours;
   s.kept = t->garment.kept;
   s.body_nodes = t->body.nodes;
   s.body_kept = t->body.kept;
   return s;
}
static void dn__garment_layout(dn_garment *g, const dn__tailor *t, const dn__garment_sizes *s, dn__arena *a)
{
   dn_garment_view *v = &g->view;
   size_t V = t->garment.vertices, I = t->body.influences, N3 = dn__mul(s->nodes, 3), k;
   v->node_of_vertex = (uint32_t *)dn__take(a, V, sizeof(uint32_t));
   v->first_vertex = (uint32_t *)dn__take(a, s->nodes, sizeof(uint32_t));
   v->rest = (float *)dn__take(a, N3, sizeof(float));
   v->triangle = (uint32_t *)dn__take(a, dn__mul(s->kept, 3), sizeof(uint32_t));
   v->graph.first = (uint32_t *)dn__take(a, dn__add(s->nodes, 1), sizeof(uint32_t));
   v->graph.next = (uint32_t *)dn__take(a, s->neighbours, sizeof(uint32_t));
   v->body_node = (uint32_t *)dn__take(a, s->nodes, sizeof(uint32_t));
   v->skin_joint = (uint32_t *)dn__take(a, dn__mul(s->nodes, I), sizeof(uint32_t));
   v->skin_weight = (float *)dn__take(a, dn__mul(s->nodes, I), sizeof(float));
   v->alpha = (float *)dn__take(a, t->desc->alphas, sizeof(float));
   v->beta = (float *)dn__take(a, t->desc->betas, sizeof(float));
   v->body_node_of_vertex = (uint32_t *)dn__take(a, t->body.vertices, sizeof(uint32_t));
   v->body_first_vertex = (uint32_t *)dn__take(a, s->body_nodes, sizeof(uint32_t));
   v->body_rest = (float *)dn__take(a, dn__mul(s->body_nodes, 3), sizeof(float));
   g->body_skin_joint = (uint32_t *)dn__take(a, dn__mul(s->body_nodes, I), sizeof(uint32_t));
   g->body_skin_weight = (float *)dn__take(a, dn__mul(s->body_nodes, I), sizeof(float));
   g->body_triangle = (uint32_t *)dn__take(a, dn__mul(s->body_kept, 3), sizeof(uint32_t));
   g->body_corner_first = (uint32_t *)dn__take(a, dn__add(s->body_nodes, 1), sizeof(uint32_t));
   g->body_corner_tri = (uint32_t *)dn__take(a, dn__mul(s->body_kept, 3), sizeof(uint32_t));
   g->rest_vertices = (float *)dn__take(a, dn__mul(V, 3), sizeof(float));
   g->anchor = (float *)dn__take(a, N3, sizeof(float));
   g->coarse_rest = (float *)dn__take(a, N3, sizeof(float));
   g->corner_first = (uint32_t *)dn__take(a, dn__add(s->nodes, 1), sizeof(uint32_t));
   g->corner_tri = (uint32_t *)dn__take(a, dn__mul(s->kept, 3), sizeof(uint32_t));
   for (k = 0; k < 2; k++) {
      size_t joints = t->model[k] ? t->model[k]->info.joints : 0;
      g->joints[k].map = (uint32_t *)dn__take(a, joints, sizeof(uint32_t));
      g->joints[k].joint_rest = (float *)dn__take(a, dn__mul(joints, 3), sizeof(float));
      g->joints[k].fold = (uint32_t *)dn__take(a, t->model[k] ? t->body.joints : 0, sizeof(uint32_t));
      if (dn__tailor_wants_clusters(t)) {
         dn__clusters_layout(&g->clusters[k], s->nodes, s->neighbours, a);
         g->clusters[k].score = (float *)dn__take(a, s->nodes, sizeof(float));
      }
   }
}

/* --- what garment and body have to do with each other. I: each garment node's closest body node at rest (T 4.3, C 4.1) */
static void dn__garment_seat(dn_garment *g, void *scratch, const dn_parallel *parallel)
{
   dn_garment_view *v = &g->view;
   size_t i, I = v->influences;
   dn_associate(v->body_rest, v->body_nodes, v->rest, v->nodes, (uint32_t *)v->body_node, scratch, parallel);
   for (i = 0; i < v->nodes; i++) {
      size_t b = v->body_node[i];
      memcpy((float *)g->anchor + 3 * i, v->body_rest + 3 * b, 12);
      memcpy((uint32_t *)v->skin_joint + I * i, g->body_skin_joint + I * b, I * sizeof(uint32_t));
      memcpy((float *)v->skin_weight + I * i, g->body_skin_weight + I * b, I * sizeof(float));
   }
}
/* nodes and vertices at rest, from positions (V,3) with a stride in bytes */
static void dn__garment_place(dn_garment *g, const float *body, size_t body_stride, const float *garment,
                              size_t garment_stride)
{
   dn_garment_view *v = &g->view;
   size_t i;
   for (i = 0; body && i < v->body_nodes; i++)
      memcpy((float *)v->body_rest + 3 * i, (const unsigned char *)body + v->body_first_vertex[i] * body_stride, 12);
   if (!garment) return;
   for (i = 0; i < v->vertices; i++)
      memcpy((float *)g->rest_vertices + 3 * i, (const unsigned char *)garment + i * garment_stride, 12);
   for (i = 0; i < v->nodes; i++)
      memcpy((float *)v->rest + 3 * i, g->rest_vertices + 3 * (size_t)v->first_vertex[i], 12);
   for (g->spread = 0, i = 0; i < 3 * v->vertices; i++) {
      float x = g->rest_vertices[i], y = v->rest[3 * (size_t)v->node_of_vertex[i / 3] + i % 3];
      g->spread |= x < y || x > y;
   }
}
/* "rest" pooling: the networks up to the pools with every palette entry the identity and theta 0 */
static void dn__garment_renew(dn_garment *g, void *work, size_t work_bytes, const dn_parallel *parallel)
{
   dn__arena a = dn__arena_of(work, work_bytes);
   float *identity;
   void *scratch;
   size_t s, k;
   dn_garment_pose pose;
   dn__wear f;
   g->has_clusters = 0;
   if (!g->wants_clusters) return;
   identity = (float *)dn__take(&a, dn__mul(g->view.joints, 12), sizeof(float));
   scratch = (unsigned char *)work + a.used;
   for (s = 0; s < g->view.joints; s++)
      for (k = 0; k < 12; k++) identity[12 * s + k] = k % 5 == 0 ? 1.0f : 0.0f;
   memset(&pose, 0, sizeof pose);
   pose.palette = identity;
   if (g->has_coarse_rest) pose.coarse_displacement = g->coarse_rest;
   dn_garment_stage_follow(g, &pose, scratch, work_bytes - a.used, parallel, NULL);
   dn_garment_stage_coarse(g, &pose, scratch, parallel, NULL);
   f = dn__wear_of(g, scratch, dn__workers(parallel));
   dn__garment_network(g, &f, &pose, 1, NULL, parallel, NULL, g->clusters);
   g->has_clusters = 1;
}

static dn_result dn__tailor_prepare(dn__tailor *t)
{
   dn_result r = dn__bind_prepare(&t->body);
   if (r == DN_OK) r = dn__bind_prepare(&t->garment);
   t->report.body = t->body.report;
   t->report.garment = t->garment.report;
   return r;
}
static dn_result dn__garment_joints(dn__tailor *t, dn_garment *g, size_t k)
{
   dn__binding *at = &g->joints[k];
   dn__bind *b = &t->body;
   dn_result r;
   if (!t->model[k]) return DN_OK;
   b->model = t->model[k];
   b->model_joints = t->model[k]->info.joints;
   b->report.joints_matched = b->report.joints_folded = 0;
   if ((r = dn__bind_joints(b, (uint32_t *)at->map, (uint32_t *)at->fold)) != DN_OK) return r;
   if ((r = dn__bind_joint_rest(b, at->map, (float *)at->joint_rest)) != DN_OK) return r;
   at->root = b->model_joints ? at->map[0] : 0;
   if (b->report.joints_folded == 0) at->fold = NULL;
   t->report.body.joints_matched = dn__max(t->report.body.joints_matched, b->report.joints_matched);
   t->report.body.joints_folded = dn__max(t->report.body.joints_folded, b->report.joints_folded);
   return DN_OK;
}
static void dn__garment_copy(dn__tailor *t, dn_garment *g)
{
   dn_garment_view *v = &g->view;
   const dn__bind *b = &t->body, *c = &t->garment;
   size_t i, I = b->influences;
   v->vertices = c->vertices;
   v->nodes = v->graph.nodes = c->nodes;
   v->body_vertices = b->vertices;
   v->body_nodes = b->nodes;
   v->joints = b->joints;
   v->influences = I;
   v->triangles = c->kept;
   v->alphas = t->desc->alphas;
   v->betas = t->desc->betas;
   v->thetas = t->desc->thetas;
   memcpy((uint32_t *)v->node_of_vertex, c->node_of_vertex, c->vertices * sizeof(uint32_t));
   memcpy((uint32_t *)v->first_vertex, c->first_vertex, c->nodes * sizeof(uint32_t));
   memcpy((uint32_t *)v->triangle, c->triangle, 3 * c->kept * sizeof(uint32_t));
   memcpy((uint32_t *)v->graph.first, c->first, (c->nodes + 1) * sizeof(uint32_t));
   memcpy((uint32_t *)v->graph.next, c->next, c->neighbours * sizeof(uint32_t));
   memcpy((uint32_t *)v->body_node_of_vertex, b->node_of_vertex, b->vertices * sizeof(uint32_t));
   memcpy((uint32_t *)v->body_first_vertex, b->first_vertex, b->nodes * sizeof(uint32_t));
   memcpy((uint32_t *)g->body_triangle, b->triangle, 3 * b->kept * sizeof(uint32_t));
   for (i = 0; i < b->nodes; i++) {
      memcpy((uint32_t *)g->body_skin_joint + I * i, b->joint + I * (size_t)b->first_vertex[i], I * sizeof(uint32_t));
      memcpy((float *)g->body_skin_weight + I * i, b->weight + I * (size_t)b->first_vertex[i], I * sizeof(float));
   }
   if (v->alphas) memcpy((float *)v->alpha, t->desc->alpha, v->alphas * sizeof(float));
   if (v->betas) memcpy((float *)v->beta, t->desc->beta, v->betas * sizeof(float));
   dn__corners_build(v->triangle, c->kept, c->nodes, (uint32_t *)g->corner_first, (uint32_t *)g->corner_tri);
   dn__corners_build(g->body_triangle, b->kept, b->nodes, (uint32_t *)g->body_corner_first,
                     (uint32_t *)g->body_corner_tri);
}
static dn_result dn__garment_coarse_rest(dn_garment *g, const float *coarse_rest, dn_error *err)
{
   dn_result r = dn__garment_numbers(coarse_rest, coarse_rest ? 3 * g->view.nodes : 0, "coarse_rest: number ", err);
   if (r != DN_OK || !coarse_rest) return r;
   memcpy((float *)g->coarse_rest, coarse_rest, 3 * g->view.nodes * sizeof(float));
   g->has_coarse_rest = 1;
   return DN_OK;
}
static dn_result dn__garment_finish(dn__tailor *t, dn_garment *g)
{
   dn_garment_view *v = &g->view;
   double farthest = 0.0;
   size_t i, k;
   dn_result r;
   unsigned char *used = (unsigned char *)t->body.joint; /* no longer needed once copied: a byte for each body node */
   g->model[0] = t->model[0];
   g->model[1] = t->model[1];
   g->wants_clusters = dn__tailor_wants_clusters(t);
   g->bandwidth = t->garment.bandwidth;
   dn__garment_copy(t, g);
   for (k = 0; k < 2; k++)
      if ((r = dn__garment_joints(t, g, k)) != DN_OK) return r;
   if (t->desc->coarse_rest && t->desc->coarse_rest_nodes != v->nodes)
      return dn__fail_sizes(t->err, DN_BAD_SHAPE, dn__where_garment, SIZE_MAX, "coarse_rest: ",
                            t->desc->coarse_rest_nodes, " nodes given, the garment has ", v->nodes, NULL);
   if ((r = dn__garment_coarse_rest(g, t->desc->coarse_rest, t->err)) != DN_OK) return r;
   dn__garment_place(g, t->body.positions, 12, t->garment.positions, 12);
   if (dn__step(&t->garment, "association", 0.0f)) return dn__cancelled(&t->garment);
   dn__garment_seat(g, t->work, t->desc->parallel);
   memset(used, 0, v->body_nodes);
   for (i = 0; i < v->nodes; i++) {
      const float *p = v->rest + 3 * i, *q = g->anchor + 3 * i;
      double x = (double)p[0] - (double)q[0], y = (double)p[1] - (double)q[1], z = (double)p[2] - (double)q[2];
      double d = DN_SQRT(x * x + y * y + z * z);
      farthest = d > farthest ? d : farthest;
      t->report.body_nodes_used += !used[v->body_node[i]];
      used[v->body_node[i]] = 1;
   }
   t->report.farthest = (float)farthest;
   if (g->wants_clusters && dn__step(&t->garment, "rest pooling", 0.0f)) return dn__cancelled(&t->garment);
   dn__garment_renew(g, t->work, t->work_bytes, t->desc->parallel);
   dn__step(&t->garment, "done", 1.0f);
   return DN_OK;
}

DN_API dn_result dn_garment_size(const dn_garment_desc *desc, size_t *bytes, size_t *scratch, dn_error *err)
{
   dn__tailor t;
   dn__arena kept = dn__arena_of(NULL, 0), temp = dn__arena_of(NULL, 0);
   dn__garment_sizes s;
   dn_garment measure;
   dn_result r;
   DN_ASSERT(desc && bytes && scratch);
   if ((r = dn__tailor_open(&t, desc, err)) != DN_OK) return r;
   s = dn__garment_bounds(&t);
   dn__take(&kept, 1, sizeof(dn_garment));
   dn__garment_layout(&measure, &t, &s, &kept);
   dn__tailor_memory(&t, &temp);
   *bytes = kept.used;
   *scratch = temp.used;
   return *bytes == SIZE_MAX || *scratch == SIZE_MAX ? dn__fail(err, DN_NO_MEMORY, dn__where_garment, SIZE_MAX,
                                                                "sizes overflow") : DN_OK;
}
/* prepared meshes into memory of exactly the right size */
static dn_result dn__garment_build(dn__tailor *t, void *memory, size_t bytes, dn_garment **garment)
{
   dn__arena kept = dn__arena_of(memory, bytes);
   dn__garment_sizes s = dn__garment_exact(t);
   dn_garment *g = (dn_garment *)dn__take(&kept, 1, sizeof(dn_garment));
   dn_result r;
   if (!g)
      return dn__fail_sizes(t->err, DN_TOO_SMALL, dn__where_garment, SIZE_MAX, "memory: ", bytes,
                            " bytes given, too small", 0, NULL);
   memset(g, 0, sizeof *g);
   dn__garment_layout(g, t, &s, &kept);
   if (kept.used > bytes)
      return dn__fail_sizes(t->err, DN_TOO_SMALL, dn__where_garment, SIZE_MAX, "memory: ", bytes,
                            " bytes given, needed ", kept.used, NULL);
   g->view.bytes = kept.used;
   if ((r = dn__garment_finish(t, g)) != DN_OK) return r;
   *garment = g;
   return DN_OK;
}
static dn_result dn__tailor_start(dn__tailor *t, const dn_garment_desc *desc, void *scratch, size_t scratch_bytes,
                                  dn_error *err)
{
   dn__arena temp = dn__arena_of(scratch, scratch_bytes);
   dn_result r = dn__tailor_open(t, desc, err);
   if (r != DN_OK) return r;
   dn__tailor_memory(t, &temp);
   if (temp.used > scratch_bytes)
      return dn__fail_sizes(err, DN_TOO_SMALL, dn__where_garment, SIZE_MAX, "scratch: ", scratch_bytes,
                            " bytes given, needed ", temp.used, NULL);
   return dn__tailor_prepare(t);
}
DN_API dn_result dn_garment_init(const dn_garment_desc *desc, void *memory, size_t bytes, void *scratch,
                                 size_t scratch_bytes, dn_garment **garment, dn_garment_report *report, dn_error *err)
{
   dn__tailor t;
   dn_result r;
   DN_ASSERT(desc && memory && scratch && garment && ((uintptr_t)memory & 63) == 0 && ((uintptr_t)scratch & 63) == 0);
   *garment = NULL;
   r = dn__tailor_start(&t, desc, scratch, scratch_bytes, err);
   if (r == DN_OK) r = dn__garment_build(&t, memory, bytes, garment);
   if (r == DN_OK && report) *report = t.report;
   return r;
}
DN_API dn_garment *dn_garment_create(const dn_garment_desc *desc, const dn_allocator *allocator,
                                     dn_garment_report *report, dn_error *err)
{
   dn__tailor t;
   dn_garment *garment = NULL;
   size_t bytes = 0, scratch_bytes = 0;
   void *scratch, *memory = NULL;
   if (dn_garment_size(desc, &bytes, &scratch_bytes, err) != DN_OK) return NULL;
   scratch = dn__alloc(allocator, scratch_bytes);
   if (!scratch) {
      dn__fail_sizes(err, DN_NO_MEMORY, dn__where_garment, SIZE_MAX, "scratch of ", scratch_bytes, NULL, 0, " bytes");
      return NULL;
   }
   if (dn__tailor_start(&t, desc, scratch, scratch_bytes, err) == DN_OK) { /* welded: the size is exact now */
      dn__arena kept = dn__arena_of(NULL, 0);
      dn__garment_sizes s = dn__garment_exact(&t);
      dn_garment measure;
      dn__take(&kept, 1, sizeof(dn_garment));
      dn__garment_layout(&measure, &t, &s, &kept);
      bytes = kept.used;
      memory = dn__alloc(allocator, bytes);
      if (!memory)
         dn__fail_sizes(err, DN_NO_MEMORY, dn__where_garment, SIZE_MAX, "garment of ", bytes, NULL, 0, " bytes");
      else if (dn__garment_build(&t, memory, bytes, &garment) != DN_OK) dn__release(allocator, memory, bytes);
   }
   dn__release(allocator, scratch, scratch_bytes);
   if (garment) {
      garment->owned = 1;
      if (allocator) garment->allocator = *allocator, garment->allocator_used = &garment->allocator;
      if (report) *report = t.report;
   }
   return garment;
}
DN_API void dn_garment_free(dn_garment *g)
{
   if (g && g->owned) {
      dn_allocator a = g->allocator; /* the copy inside goes with the memory */
      dn__release(g->allocator_used ? &a : NULL, g, g->view.bytes);
   }
}
DN_API void dn_garment_describe(const dn_garment *g, dn_garment_view *view) { *view = g->view; }

/* --- change: everything is checked first, so that a refusal leaves the garment as it was */
DN_API size_t dn_garment_change_size(const dn_garment *g, unsigned workers)
{
   dn__wear_sizes s = dn__wear_sizes_of(g);
   size_t joints = 0, k;
   for (k = 0; k < 2; k++) joints = dn__max(joints, g->model[k] ? g->model[k]->info.joints : 0);
   return dn__max(dn__renew_bytes(g->model, &s, g->wants_clusters, workers ? workers : 1),
                  dn__round(dn__mul(2 * joints, 3 * sizeof(float)), DN__ALIGN));
}
static dn_result dn__change_positions(const float *p, size_t stride, size_t vertices, const char *what, dn_error *err)
{
   size_t v;
   for (v = 0; p && v < vertices; v++) {
      float x[3];
      memcpy(x, (const unsigned char *)p + v * stride, 12);
      if (!dn__finite3(x))
         return dn__fail_sizes(err, DN_BAD_MESH, "garment change", v, what, v, NULL, 0,
                               ": its position is not finite");
   }
   return DN_OK;
}
DN_API dn_result dn_garment_change(dn_garment *g, const dn_garment_changes *c, void *scratch, size_t scratch_bytes,
                                   dn_error *err)
{
   size_t need = dn_garment_change_size(g, dn__workers(c->parallel)), k,
      body_stride = dn__stride(c->body_position_stride, 12);
   size_t garment_stride = dn__stride(c->garment_position_stride, 12);
   float *joint_rest[2];
   dn_garment_view *v = &g->view;
   dn_rig_desc desc;
   dn__bind b;
   dn_result r;
   DN_ASSERT(c && scratch && ((uintptr_t)scratch & 63) == 0);
   if (scratch_bytes < need)
      return dn__fail_sizes(err, DN_TOO_SMALL, "garment change", SIZE_MAX, "scratch: ", scratch_bytes,
                            " bytes given, needed ", need, NULL);
   if ((r = dn__change_positions(c->body_positions, body_stride, v->body_vertices, "body vertex ", err)) != DN_OK)
      return r;
   if ((r = dn__change_positions(c->garment_positions, garment_stride, v->vertices, "garment vertex ", err)) != DN_OK)
      return r;
   if ((r = dn__garment_numbers(c->alpha, c->alpha ? v->alphas : 0, "alpha ", err)) != DN_OK) return r;
   if ((r = dn__garment_numbers(c->beta, c->beta ? v->betas : 0, "beta ", err)) != DN_OK) return r;
   if ((r = dn__garment_numbers(c->coarse_rest, c->coarse_rest ? 3 * v->nodes : 0, "coarse_rest: number ",
                                err)) != DN_OK) return r;
   memset(&desc, 0, sizeof desc);
   memset(&b, 0, sizeof b);
   desc.skeleton.inverse_bind = c->inverse_bind;
   desc.skeleton.matrix = c->matrix;
   b.where = "garment change";
   b.desc = &desc;
   b.err = err;
   joint_rest[0] = joint_rest[1] = (float *)scratch;
   for (k = 0; k < 2 && c->inverse_bind; k++) {
      b.model_joints = g->model[k] ? g->model[k]->info.joints : 0;
      if (k == 1) joint_rest[1] += 3 * (g->model[0] ? g->model[0]->info.joints : 0);
      if ((r = dn__bind_joint_rest(&b, g->joints[k].map, joint_rest[k])) != DN_OK) return r;
   }

   for (k = 0; k < 2 && c->inverse_bind; k++)
      if (g->model[k])
         memcpy((float *)g->joints[k].joint_rest, joint_rest[k], 3 * g->model[k]->info.joints * sizeof(float));
   if (c->alpha && v->alphas) memcpy((float *)v->alpha, c->alpha, v->alphas * sizeof(float));
   if (c->beta && v->betas) memcpy((float *)v->beta, c->beta, v->betas * sizeof(float));
   dn__garment_coarse_rest(g, c->coarse_rest, NULL);
   if (c->body_positions || c->garment_positions) {
      dn__garment_place(g, c->body_positions, body_stride, c->garment_positions, garment_stride);
      dn__garment_seat(g, scratch, c->parallel);
   }
   dn__garment_renew(g, scratch, scratch_bytes, c->parallel);
   return DN_OK;
}


/* ===================================================================================== >>dressed
   in       dn_shapes of a body and its garments, coefficients; each frame theta     out   dn_dressed; body and garments (V,3)
   touches  creation and change: its memory and scratch; a frame: its scratch and the caller's output arrays
   flow     dn__wardrobe_measure -> dn_dressed_init; a frame: kinematics -> body -> garments by rising layer
   read     dn_dressed_deform */

typedef struct dn__outfit { /* one garment */
   dn_dressed_garment desc; /* alpha is in the dn_garment */
   dn_shape_view shape;
   float *rest;             /* (V,3) in the present shape and looseness */
   void *memory;            /* of the dn_garment */
   size_t bytes;
} dn__outfit;
struct dn_dressed {
   dn_dressed_view view;
   const dn_shape *body;
   dn_shape_view shape;      /* the body's */
   const dn_model *refine;
   size_t thetas;
   unsigned resolution;
   dn_allocator allocator;
   const dn_allocator *allocator_used; /* NULL: DN_MALLOC, or &allocator */
   int owned;
   int usable;               /* 0: a change failed half way */
   float *beta, *rest, *joint_rest, *inverse_bind, *offsets; /* (B), (V,3), (S,3), (S,12), (S,3) */
   dn__outfit *outfit;       /* (garments) */
   const dn_garment **garment;
   uint32_t *order;          /* (garments) by layer, then as given */
   dn_rig *rig;
   void *rig_memory;
   size_t rig_bytes;
};
static const char dn__where_dressed[] = "dressed";

/* --- descriptors of the parts; skin must live as long as they do */
static void dn__dressed_skin(const dn_shape_view *s, dn_skin_set *skin)
{
   memset(skin, 0, sizeof *skin);
   skin->influences = s->influences;
   skin->joints = s->skin_joint;
   skin->joint_type = DN_U32;
   skin->weights = s->skin_weight;
   skin->weight_type = DN_F32;
}
static dn_mesh dn__dressed_mesh(const dn_shape_view *s, const float *positions, const dn_skin_set *skin)
{
   dn_mesh m;
   memset(&m, 0, sizeof m);
   m.vertices = s->vertices;
   m.positions = positions;
   m.triangles = s->triangles;
   m.indices = s->triangle;
   m.index_type = DN_U32;
   m.skin_sets = skin ? 1 : 0;
   m.skin = skin;
   return m;
}
static dn_skeleton dn__dressed_skeleton(const dn_shape_view *s, const float *inverse_bind)
{
   dn_skeleton k;
   memset(&k, 0, sizeof k);
   k.joints = s->joints;
   k.names = s->joint_names;
   k.parents = s->parents;
   k.inverse_bind = inverse_bind;
   k.matrix = DN_3X4_ROWS;
   return k;
}
static dn_rig_desc dn__dressed_rig(const dn_shape_view *s, const float *rest, const float *inverse_bind, const dn_skin_set *skin,
                                   unsigned resolution, const dn_parallel *parallel, const dn_progress *progress)
{
   dn_rig_desc d;
   memset(&d, 0, sizeof d);
   d.mesh = dn__dressed_mesh(s, rest, skin);
   d.skeleton = dn__dressed_skeleton(s, inverse_bind);
   d.resolution = resolution;
   d.parallel = parallel;
   d.progress = progress;
   return d;
}
static dn_garment_desc dn__dressed_garment(const dn_dressed_garment *q, const dn_shape_view *body, const dn_shape_view *shape, const float *body_rest,
                                           const float *rest, const float *inverse_bind, const dn_skin_set *skin, const float *beta, size_t thetas,
                                           const dn_parallel *parallel)
{
   dn_garment_desc d;
   memset(&d, 0, sizeof d);
   d.body = dn__dressed_mesh(body, body_rest, skin);
   d.skeleton = dn__dressed_skeleton(body, inverse_bind);
   d.garment = dn__dressed_mesh(shape, rest, NULL);
   d.coarse = q->coarse;
   d.refine = q->refine;
   d.alpha = q->alpha;
   d.alphas = q->alphas;
   d.beta = beta;
   d.betas = body->coefficients;
   d.thetas = thetas ? thetas : 3 * body->joints;
   d.parallel = parallel;
   return d;
}

/* --- sizes */
static dn_result dn__dressed_number(float x, const char *what, size_t index, dn_error *err)
{
   return dn__finite(x) ? DN_OK : dn__fail_sizes(err, DN_BAD_VALUE, dn__where_dressed, index, what, index, NULL, 0, " is not finite");
}
static dn_result dn__dressed_check(const dn_dressed_desc *desc, dn_shape_view *body, dn_error *err)
{
   size_t i;
   dn_result r;
   DN_ASSERT(desc->body && (desc->garments == 0 || desc->garment) && (desc->betas == 0 || desc->beta));
   dn_shape_describe(desc->body, body);
   if (!body->joint_rest || !body->parents)
      return dn__fail(err, DN_UNSUPPORTED, dn__where_dressed, SIZE_MAX, body->parents ? "the body has no joints: joint_template or joint_regressor" : "the body has no parents");
   if (desc->betas > body->coefficients)
      return dn__fail_sizes(err, DN_BAD_SHAPE, dn__where_dressed, SIZE_MAX, "betas: found ", desc->betas, ", the body has ", body->coefficients, NULL);
   if (desc->garments >= DN__NONE) return dn__fail(err, DN_BAD_VALUE, dn__where_dressed, SIZE_MAX, "garments: too many");
   for (i = 0; i < desc->betas; i++)
      if ((r = dn__dressed_number(desc->beta[i], "beta ", i, err)) != DN_OK) return r;
   for (i = 0; i < desc->garments; i++) {
      const dn_dressed_garment *g = &desc->garment[i];
      dn_shape_view s;
      DN_ASSERT(g->shape && (g->alphas == 0 || g->alpha));
      dn_shape_describe(g->shape, &s);
      if (s.coefficients > body->coefficients)
         return dn__fail_sizes(err, DN_BAD_SHAPE, dn__where_dressed, i, "garment: found ", s.coefficients, " shape coefficients, the body has ", body->coefficients, NULL);
      if ((r = dn__dressed_number(g->looseness, "looseness of garment ", i, err)) != DN_OK) return r;
      if ((r = dn__dressed_number(g->reach, "reach of garment ", i, err)) != DN_OK) return r;
      if (!dn__finite(g->margin) || g->margin < 0.0f)
         return dn__fail_sizes(err, DN_BAD_VALUE, dn__where_dressed, i, "margin of garment ", i, NULL, 0, ": expected a finite number, at least 0");
   }
   return DN_OK;
}
/* one layout for the query and for the object; the last blocks' sizes come from the parts */
static void dn__dressed_layout(dn_dressed *d, const dn_shape_view *body, size_t garments, dn__arena *a)
{
   size_t V3 = dn__mul(body->vertices, 3), S = body->joints;
   d->beta = (float *)dn__take(a, body->coefficients, sizeof(float));
   d->rest = (float *)dn__take(a, V3, sizeof(float));
   d->joint_rest = (float *)dn__take(a, dn__mul(S, 3), sizeof(float));
   d->inverse_bind = (float *)dn__take(a, dn__mul(S, 12), sizeof(float));
   d->offsets = (float *)dn__take(a, dn__mul(S, 3), sizeof(float));
   d->outfit = (dn__outfit *)dn__take(a, garments, sizeof(dn__outfit));
   d->garment = (const dn_garment **)dn__take(a, garments, sizeof(dn_garment *));
   d->order = (uint32_t *)dn__take(a, garments, sizeof(uint32_t));
}
/* The rig's scratch depends on the shape's bounding box where geodesic distances are read; a cube bounds every box. */
static dn_result dn__dressed_rig_size(const dn_shape_view *body, const dn_model *refine, unsigned resolution, const dn_parallel *parallel,
                                      size_t *bytes, size_t *scratch, dn_error *err)
{
   static const float cube[6] = { 0.0f, 0.0f, 0.0f, 1.0f, 1.0f, 1.0f };
   dn_skin_set skin;
   dn_rig_desc q;
   dn_result r;
   size_t i;
   dn__dressed_skin(body, &skin);
   q = dn__dressed_rig(body, body->rest, NULL, &skin, resolution, parallel, NULL);
   if ((r = dn_rig_size(refine, &q, bytes, scratch, err)) != DN_OK) return r;
   for (i = 0; refine && i < refine->info.feature_count; i++)
      if (refine->info.features[i] == DN_GEODESIC) {
         *scratch = dn__add(*scratch, dn_geodesic_scratch(cube, 2, 0, dn__resolution(&q), dn__workers(parallel)));
         break;
      }
   return DN_OK;
}
static dn_result dn__dressed_garment_size(const dn_dressed_desc *desc, const dn_shape_view *body, size_t i, size_t *bytes, size_t *scratch, dn_error *err)
{
   const dn_dressed_garment *g = &desc->garment[i];
   dn_skin_set skin;
   dn_shape_view s;
   dn_garment_desc q;
   dn__dressed_skin(body, &skin);
   dn_shape_describe(g->shape, &s);
   q = dn__dressed_garment(g, body, &s, body->rest, s.rest, NULL, &skin, body->rest, desc->thetas, desc->parallel);
   q.beta = desc->body->shapedirs; /* as many finite numbers as betas: sizes depend on counts only */
   return dn_garment_size(&q, bytes, scratch, err);
}
DN_API dn_result dn_dressed_size(const dn_dressed_desc *desc, size_t *bytes, size_t *scratch, dn_error *err)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn_shape_view body, s;
   dn_dressed measure;
   size_t i, part, temp;
   dn_result r;
   DN_ASSERT(desc && bytes && scratch);
   *bytes = *scratch = 0;
   if ((r = dn__dressed_check(desc, &body, err)) != DN_OK) return r;
   dn__take(&a, 1, sizeof(dn_dressed));
   dn__dressed_layout(&measure, &body, desc->garments, &a);
   if ((r = dn__dressed_rig_size(&body, desc->refine, desc->resolution, desc->parallel, &part, scratch, err)) != DN_OK) return r;
   dn__take(&a, part, 1);
   for (i = 0; i < desc->garments; i++) {
      if ((r = dn__dressed_garment_size(desc, &body, i, &part, &temp, err)) != DN_OK) return r;
      dn_shape_describe(desc->garment[i].shape, &s);
      dn__take(&a, dn__mul(s.vertices, 3), sizeof(float));
      dn__take(&a, part, 1);
      *scratch = dn__max(*scratch, temp);
   }
   *bytes = a.used;
   return *bytes == SIZE_MAX || *scratch == SIZE_MAX ? dn__fail(err, DN_NO_MEMORY, dn__where_dressed, SIZE_MAX, "sizes overflow") : DN_OK;
}

/* --- creation */
static dn_result dn__dressed_finite(const float *p, size_t count, const char *what, dn_error *err)
{
   size_t i;
   for (i = 0; i < count; i++)
      if (!dn__finite(p[i]))
         return dn__fail_sizes(err, DN_BAD_MESH, dn__where_dressed, i / 3, what, i / 3, NULL, 0, " is not finite: the shape coefficients are too large");
   return DN_OK;
}
static void dn__dressed_body(dn_dressed *d, const dn_parallel *parallel) /* everything that beta gives */
{
   size_t s, k, S = d->shape.joints;
   dn_shape_evaluate(d->body, d->beta, d->shape.coefficients, 0.0f, d->rest, d->joint_rest, parallel);
   memset(d->inverse_bind, 0, 12 * S * sizeof(float));
   for (s = 0; s < S; s++)
      for (k = 0; k < 3; k++) { /* rest rotations are the identity */
         int32_t parent = d->shape.parents[s];
         d->inverse_bind[12 * s + 5 * k] = 1.0f;
         d->inverse_bind[12 * s + 4 * k + 3] = -d->joint_rest[3 * s + k];
         d->offsets[3 * s + k] = d->joint_rest[3 * s + k] - (parent >= 0 ? d->joint_rest[3 * (size_t)parent + k] : 0.0f);
      }
}
static void dn__dressed_cloth(const dn__outfit *o, float looseness, float *rest, const float *beta, const dn_parallel *parallel)
{
   dn_shape_evaluate(o->desc.shape, beta, o->shape.coefficients, looseness, rest, NULL, parallel);
}
static dn_result dn__dressed_bind(dn_dressed *d, void *scratch, size_t scratch_bytes, const dn_parallel *parallel, const dn_progress *progress, dn_error *err)
{
   dn_skin_set skin;
   dn_rig_desc q;
   dn__dressed_skin(&d->shape, &skin);
   q = dn__dressed_rig(&d->shape, d->rest, d->inverse_bind, &skin, d->resolution, parallel, progress);
   return dn_rig_init(d->refine, &q, d->rig_memory, d->rig_bytes, scratch, scratch_bytes, &d->rig, NULL, err);
}
DN_API dn_result dn_dressed_init(const dn_dressed_desc *desc, void *memory, size_t bytes, void *scratch, size_t scratch_bytes,
                                 dn_dressed **dressed, dn_error *err)
{
   dn__arena a = dn__arena_of(memory, bytes);
   dn_shape_view body;
   dn_skin_set skin;
   dn_dressed *d;
   size_t i, k, need, need_scratch, temp;
   dn_result r;
   DN_ASSERT(desc && memory && scratch && dressed && ((uintptr_t)memory & 63) == 0 && ((uintptr_t)scratch & 63) == 0);
   *dressed = NULL;
   if ((r = dn_dressed_size(desc, &need, &need_scratch, err)) != DN_OK || (r = dn__dressed_check(desc, &body, err)) != DN_OK) return r;
   if (bytes < need) return dn__fail_sizes(err, DN_TOO_SMALL, dn__where_dressed, SIZE_MAX, "memory: ", bytes, " bytes given, needed ", need, NULL);
   if (scratch_bytes < need_scratch)
      return dn__fail_sizes(err, DN_TOO_SMALL, dn__where_dressed, SIZE_MAX, "scratch: ", scratch_bytes, " bytes given, needed ", need_scratch, NULL);
   d = (dn_dressed *)dn__take(&a, 1, sizeof(dn_dressed));
   memset(d, 0, sizeof *d);
   dn__dressed_layout(d, &body, desc->garments, &a);
   d->body = desc->body;
   d->shape = body;
   d->refine = desc->refine;
   d->resolution = desc->resolution;
   d->thetas = desc->thetas ? desc->thetas : 3 * body.joints;
   memset(d->beta, 0, body.coefficients * sizeof(float));
   if (desc->betas) memcpy(d->beta, desc->beta, desc->betas * sizeof(float));
   dn__dressed_body(d, desc->parallel);
   if ((r = dn__dressed_finite(d->rest, 3 * body.vertices, "body vertex ", err)) != DN_OK) return r;
   if ((r = dn__dressed_finite(d->joint_rest, 3 * body.joints, "joint ", err)) != DN_OK) return r;
   if ((r = dn__dressed_rig_size(&body, desc->refine, desc->resolution, desc->parallel, &d->rig_bytes, &temp, err)) != DN_OK) return r;
   d->rig_memory = dn__take(&a, d->rig_bytes, 1);
   if ((r = dn__dressed_bind(d, scratch, scratch_bytes, desc->parallel, desc->progress, err)) != DN_OK) return r;
   dn__dressed_skin(&d->shape, &skin);
   for (i = 0; i < desc->garments; i++) {
      dn__outfit *o = &d->outfit[i];
      dn_garment_desc q;
      dn_garment *g;
      o->desc = desc->garment[i];
      dn_shape_describe(o->desc.shape, &o->shape);
      if ((r = dn__dressed_garment_size(desc, &body, i, &o->bytes, &temp, err)) != DN_OK) return r;
      o->rest = (float *)dn__take(&a, 3 * o->shape.vertices, sizeof(float));
      o->memory = dn__take(&a, o->bytes, 1);
      dn__dressed_cloth(o, o->desc.looseness, o->rest, d->beta, desc->parallel);
      if ((r = dn__dressed_finite(o->rest, 3 * o->shape.vertices, "garment vertex ", err)) != DN_OK) return r;
      q = dn__dressed_garment(&o->desc, &d->shape, &o->shape, d->rest, o->rest, d->inverse_bind, &skin, d->beta, d->thetas, desc->parallel);
      if ((r = dn_garment_init(&q, o->memory, o->bytes, scratch, scratch_bytes, &g, NULL, err)) != DN_OK) return r;
      o->desc.alpha = NULL; /* borrowed: the garment has a copy */
      d->garment[i] = g;
      for (k = i; k > 0 && d->outfit[d->order[k - 1]].desc.layer > o->desc.layer; k--) d->order[k] = d->order[k - 1];
      d->order[k] = (uint32_t)i;
   }
   d->view.vertices = body.vertices;
   d->view.joints = body.joints;
   d->view.garments = desc->garments;
   d->view.beta = d->beta;
   d->view.rest = d->rest;
   d->view.joint_rest = d->joint_rest;
   d->view.rig = d->rig;
   d->view.garment = d->garment;
   d->view.bytes = a.used;
   d->usable = 1;
   *dressed = d;
   return DN_OK;
}
DN_API dn_dressed *dn_dressed_create(const dn_dressed_desc *desc, const dn_allocator *allocator, dn_error *err)
{
   dn_dressed *d = NULL;
   size_t bytes = 0, scratch_bytes = 0;
   void *memory, *scratch;
   if (dn_dressed_size(desc, &bytes, &scratch_bytes, err) != DN_OK) return NULL;
   memory = dn__alloc(allocator, bytes);
   scratch = memory ? dn__alloc(allocator, scratch_bytes) : NULL;
   if (!scratch) dn__fail_sizes(err, DN_NO_MEMORY, dn__where_dressed, SIZE_MAX, "dressed character of ", bytes, " bytes and scratch of ", scratch_bytes, " bytes");
   else dn_dressed_init(desc, memory, bytes, scratch, scratch_bytes, &d, err);
   dn__release(allocator, scratch, scratch_bytes);
   if (d) {
      d->owned = 1;
      d->view.bytes = bytes; /* what free is told */
      if (allocator) d->allocator = *allocator, d->allocator_used = &d->allocator;
   } else dn__release(allocator, memory, bytes);
   return d;
}
DN_API void dn_dressed_free(dn_dressed *d)
{
   if (d && d->owned) {
      dn_allocator a = d->allocator; /* the copy inside goes with the memory */
      dn__release(d->allocator_used ? &a : NULL, d, d->view.bytes);
   }
}
DN_API void dn_dressed_describe(const dn_dressed *d, dn_dressed_view *view) { *view = d->view; }

/* --- change. First everything that can be wrong is tried out in scratch; only then is the character touched. */
static void dn__run_here(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job)
{
   (void)user, (void)grain;
   fn(job, 0, count, 0);
}
typedef struct dn__alter { float *beta, *positions, *joints; void *work; size_t work_bytes; } dn__alter;
static void dn__alter_layout(const dn_dressed *d, dn__alter *c, unsigned workers, dn__arena *a)
{
   size_t i, most = d->shape.vertices, bytes;
   dn_parallel count;
   memset(&count, 0, sizeof count);
   c->work_bytes = 0;
   if (d->refine) { /* as if so many workers came; what this query could refuse, creation would have refused */
      count.run = dn__run_here;
      count.workers = workers;
      (void)dn__dressed_rig_size(&d->shape, d->refine, d->resolution, &count, &bytes, &c->work_bytes, NULL);
   }
   for (i = 0; i < d->view.garments; i++) {
      most = dn__max(most, d->outfit[i].shape.vertices);
      c->work_bytes = dn__max(c->work_bytes, dn_garment_change_size(d->garment[i], workers));
   }
   c->beta = (float *)dn__take(a, d->shape.coefficients, sizeof(float));
   c->positions = (float *)dn__take(a, dn__mul(most, 3), sizeof(float));
   c->joints = (float *)dn__take(a, dn__mul(d->shape.joints, 3), sizeof(float));
   c->work = dn__take(a, c->work_bytes, 1);
}
DN_API size_t dn_dressed_change_size(const dn_dressed *d, unsigned workers)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn__alter c;
   dn__alter_layout(d, &c, workers ? workers : 1, &a);
   return a.used;
}
DN_API dn_result dn_dressed_change(dn_dressed *d, const dn_dressed_changes *q, void *scratch, size_t scratch_bytes, dn_error *err)
{
   dn__arena a = dn__arena_of(scratch, scratch_bytes);
   dn__alter c;
   size_t i, k;
   dn_result r;
   DN_ASSERT(d && q && scratch && ((uintptr_t)scratch & 63) == 0 && (!q->beta || q->betas <= d->shape.coefficients));
   dn__alter_layout(d, &c, dn__workers(q->parallel), &a);
   if (a.used > scratch_bytes)
      return dn__fail_sizes(err, DN_TOO_SMALL, "dressed change", SIZE_MAX, "scratch: ", scratch_bytes, " bytes given, needed ", a.used, NULL);
   memcpy(c.beta, d->beta, d->shape.coefficients * sizeof(float));
   if (q->beta) {
      for (i = 0; i < q->betas; i++)
         if ((r = dn__dressed_number(q->beta[i], "beta ", i, err)) != DN_OK) return r;
      memset(c.beta, 0, d->shape.coefficients * sizeof(float));
      if (q->betas) memcpy(c.beta, q->beta, q->betas * sizeof(float));
      dn_shape_evaluate(d->body, c.beta, d->shape.coefficients, 0.0f, c.positions, c.joints, q->parallel);
      if ((r = dn__dressed_finite(c.positions, 3 * d->shape.vertices, "body vertex ", err)) != DN_OK) return r;
      if ((r = dn__dressed_finite(c.joints, 3 * d->shape.joints, "joint ", err)) != DN_OK) return r;
   }
   for (i = 0; i < d->view.garments; i++) {
      const dn__outfit *o = &d->outfit[i];
      dn_garment_view g;
      dn_garment_describe(d->garment[i], &g);
      if (q->looseness && (r = dn__dressed_number(q->looseness[i], "looseness of garment ", i, err)) != DN_OK) return r;
      for (k = 0; q->alpha && q->alpha[i] && k < g.alphas; k++)
         if ((r = dn__dressed_number(q->alpha[i][k], "alpha of garment ", i, err)) != DN_OK) return r;
      if (!q->beta && !q->looseness) continue;
      dn__dressed_cloth(o, q->looseness ? q->looseness[i] : o->desc.looseness, c.positions, c.beta, q->parallel);
      if ((r = dn__dressed_finite(c.positions, 3 * o->shape.vertices, "garment vertex ", err)) != DN_OK) return r;
   }

   if (q->beta) {
      memcpy(d->beta, c.beta, d->shape.coefficients * sizeof(float));
      dn__dressed_body(d, q->parallel);
      if (d->refine) { /* without a model the rig serves for its topology only */
         d->usable = 0;
         if ((r = dn__dressed_bind(d, c.work, c.work_bytes, q->parallel, q->progress, err)) != DN_OK) return r;
         d->view.rig = d->rig;
      }
   }
   for (i = 0; i < d->view.garments; i++) {
      dn__outfit *o = &d->outfit[i];
      dn_garment_changes g;
      int looser = q->looseness && q->looseness[i] != o->desc.looseness;
      memset(&g, 0, sizeof g);
      if (!q->beta && !looser && !(q->alpha && q->alpha[i])) continue;
      if (q->looseness) o->desc.looseness = q->looseness[i];
      if (q->beta || looser) {
         dn__dressed_cloth(o, o->desc.looseness, o->rest, d->beta, q->parallel);
         g.garment_positions = o->rest;
      }
      if (q->beta) {
         g.body_positions = d->rest;
         g.inverse_bind = d->inverse_bind;
         g.matrix = DN_3X4_ROWS;
         g.beta = d->beta;
      }
      g.alpha = q->alpha ? q->alpha[i] : NULL;
      g.parallel = q->parallel;
      d->usable = 0;
      if ((r = dn_garment_change((dn_garment *)o->memory, &g, c.work, c.work_bytes, err)) != DN_OK) return r;
   }
   d->usable = 1;
   return DN_OK;
}

/* --- a frame */
typedef struct dn__stroll {
   float *rotations, *palette;      /* (S,9), (S,12) */
   float *theta;                    /* (thetas) zeros for models whose pose is not given */
   float *rest;                     /* (V,3) with pose offsets, or NULL: the rest as it is */
   float *body;                     /* (V,3) posed */
   float *nodes;                    /* (N,3) of the body's rig, for the collision pass */
   void *rig;
   size_t rig_bytes;
   void *skin, *collide;            /* the body's surface; the largest garment's pass */
   dn_surface *surface;             /* (garments+1) the last is the body's */
   dn_obstacle *obstacle;           /* (garments+1) */
   void **worn, **hull;             /* (garments) scratch of each garment; its surface, NULL when nobody asks for it */
   size_t *worn_bytes;
} dn__stroll;
static int dn__collides(const dn_dressed *d, size_t i) { return d->outfit[i].desc.margin > 0.0f; }
/* some garment over garment i keeps a margin to it */
static int dn__is_under(const dn_dressed *d, size_t i)
{
   size_t k;
   for (k = 0; k < d->view.garments; k++)
      if (dn__collides(d, k) && d->outfit[k].desc.layer > d->outfit[i].desc.layer) return 1;
   return 0;
}
static void dn__stroll_layout(const dn_dressed *d, dn__stroll *f, unsigned workers, dn__arena *a)
{
   size_t i, n = d->view.garments, S = d->shape.joints, V3 = dn__mul(d->shape.vertices, 3), most = 0;
   int any = 0;
   dn_rig_view rig;
   dn_rig_describe(d->rig, &rig);
   memset(f, 0, sizeof *f);
   f->rotations = (float *)dn__take(a, dn__mul(S, 9), sizeof(float));
   f->palette = (float *)dn__take(a, dn__mul(S, 12), sizeof(float));
   f->theta = (float *)dn__take(a, d->thetas, sizeof(float));
   f->rest = d->shape.has_pose_offsets ? (float *)dn__take(a, V3, sizeof(float)) : NULL;
   f->body = (float *)dn__take(a, V3, sizeof(float));
   f->rig_bytes = dn_scratch_size(d->rig, workers);
   f->rig = dn__take(a, f->rig_bytes, 1);
   f->worn = (void **)dn__take(a, n, sizeof(void *));
   f->hull = (void **)dn__take(a, n, sizeof(void *));
   f->worn_bytes = (size_t *)dn__take(a, n, sizeof(size_t));
   f->surface = (dn_surface *)dn__take(a, dn__add(n, 1), sizeof(dn_surface));
   f->obstacle = (dn_obstacle *)dn__take(a, dn__add(n, 1), sizeof(dn_obstacle));
   for (i = 0; i < n; i++) {
      dn_garment_view g;
      size_t bytes = dn_garment_scratch_size(d->garment[i], workers);
      void *worn = dn__take(a, bytes, 1), *hull = NULL;
      dn_garment_describe(d->garment[i], &g);
      if (g.triangles && dn__is_under(d, i)) hull = dn__take(a, dn_surface_size(g.nodes, g.triangles), 1);
      if (a->base && a->used <= a->size) f->worn[i] = worn, f->hull[i] = hull, f->worn_bytes[i] = bytes;
      if (dn__collides(d, i)) any = 1, most = dn__max(most, g.nodes);
   }
   if (any) {
      f->nodes = (float *)dn__take(a, dn__mul(rig.nodes, 3), sizeof(float));
      f->skin = rig.triangles ? dn__take(a, dn_surface_size(rig.nodes, rig.triangles), 1) : NULL;
      f->collide = dn__take(a, dn_collide_scratch(most), 1);
   }
}
DN_API size_t dn_dressed_scratch_size(const dn_dressed *d, unsigned workers)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn__stroll f;
   dn__stroll_layout(d, &f, workers ? workers : 1, &a);
   return a.used;
}
typedef struct dn__dressed_skin_job { const dn_shape_view *shape; const float *rest, *palette; float *out; } dn__dressed_skin_job;
static void dn__dressed_skin_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__dressed_skin_job *j = (const dn__dressed_skin_job *)job;
   size_t I = j->shape->influences;
   (void)worker;
   dn_lbs(j->rest + 3 * begin, j->shape->skin_joint + I * begin, j->shape->skin_weight + I * begin, I, end - begin, j->palette, j->out + 3 * begin);
}
/* theta -> palette -> posed body, in f->body */
static dn_result dn__dressed_pose_body(const dn_dressed *d, const dn_dressed_pose *pose, dn_dressed_mesh *body, dn__stroll *f,
                                       const dn_parallel *parallel, dn_error *err)
{
   size_t s, k, v, S = d->shape.joints;
   dn__dressed_skin_job job;
   dn_pose p;
   dn_output out;
   dn_result r;
   for (s = 0; s < S; s++) {
      if (pose->rotations) memcpy(f->rotations + 9 * s, pose->rotations + 9 * s, 9 * sizeof(float));
      else dn_rodrigues(pose->theta + 3 * s, f->rotations + 9 * s);
   }
   dn_forward_kinematics(d->shape.parents, d->offsets, f->rotations, S, f->palette);
   for (s = 0; s < S; s++)
      for (k = 0; k < 3; k++) f->palette[12 * s + 4 * k + 3] += pose->translation[k];
   dn_palette(f->palette, d->inverse_bind, S, f->palette);
   job.shape = &d->shape;
   job.palette = f->palette;
   job.rest = d->rest;
   job.out = f->body;
   if (f->rest) { /* v = W(template + shapedirs beta + posedirs (R - I)) */
      memcpy(f->rest, d->rest, 3 * d->shape.vertices * sizeof(float));
      dn_shape_pose_offsets(d->body, f->rotations, f->rest, parallel);
      job.rest = f->rest;
   }
   dn__for(parallel, d->shape.vertices, 16 * DN__KIT_GRAIN, dn__dressed_skin_range, &job);
   memset(&p, 0, sizeof p);
   memset(&out, 0, sizeof out);
   p.palette = f->palette;
   p.matrix = DN_3X4_ROWS;
   p.strength = pose->strength;
   p.skinned = f->body;
   out.positions = f->body;
   if (body) out.normals = body->normals, out.normal_stride = body->normal_stride;
   r = dn_deform(d->rig, &p, &out, f->rig, f->rig_bytes, parallel, err);
   if (body) {
      memcpy(body->bounds_min, out.bounds_min, sizeof out.bounds_min);
      memcpy(body->bounds_max, out.bounds_max, sizeof out.bounds_max);
      body->fallback_nodes = out.fallback_nodes;
      memset(&body->collision, 0, sizeof body->collision);
      for (v = 0; body->positions && v < d->shape.vertices; v++)
         memcpy((unsigned char *)body->positions + v * dn__stride(body->position_stride, 12), f->body + 3 * v, 12);
   }
   return r;
}
/* garment i, whose lower layers are done */
static dn_result dn__dressed_wear(const dn_dressed *d, size_t i, const dn_dressed_pose *pose, dn_dressed_mesh *mesh, dn__stroll *f,
                                  const dn_parallel *parallel, dn_error *err)
{
   const dn__outfit *o = &d->outfit[i];
   const dn_garment *g = d->garment[i];
   dn_garment_pose p;
   dn_garment_output out;
   dn_garment_nodes nodes;
   dn_garment_view view;
   dn_collision found;
   dn_result r;
   size_t k, count = 0;
   memset(&p, 0, sizeof p);
   memset(&out, 0, sizeof out);
   memset(&found, 0, sizeof found);
   p.palette = f->palette;
   p.matrix = DN_3X4_ROWS;
   p.theta = pose->parameters ? pose->parameters : d->thetas == 3 * d->shape.joints && pose->theta ? pose->theta : f->theta;
   p.body = f->body;
   p.strength = pose->strength;
   if (mesh) {
      out.positions = mesh->positions;
      out.position_stride = mesh->position_stride;
      out.normals = mesh->normals;
      out.normal_stride = mesh->normal_stride;
   }
   if ((r = dn_garment_stage_follow(g, &p, f->worn[i], f->worn_bytes[i], parallel, err)) != DN_OK && r != DN_NOT_FINITE) return r;
   dn_garment_stage_coarse(g, &p, f->worn[i], parallel, NULL);
   dn_garment_stage_refine(g, &p, f->worn[i], parallel, NULL);
   nodes = dn_garment_nodes_of(g, f->worn[i]);
   dn_garment_describe(g, &view);
   if (dn__collides(d, i)) {
      if (f->skin) {
         f->obstacle[count].surface = &f->surface[d->view.garments];
         f->obstacle[count].margin = o->desc.margin;
         f->obstacle[count++].reach = 0.0f;
      }
      for (k = 0; k < d->view.garments; k++) {
         if (!f->hull[k] || d->outfit[k].desc.layer >= o->desc.layer) continue;
         f->obstacle[count].surface = &f->surface[k];
         f->obstacle[count].margin = o->desc.margin;
         f->obstacle[count++].reach = o->desc.reach > 0.0f ? o->desc.reach : 0.05f;
      }
      dn_collide(f->obstacle, count, &view.graph, nodes.refined, view.nodes, &found, f->collide, parallel);
   }
   if (f->hull[i]) dn_surface_build(&f->surface[i], nodes.refined, view.nodes, view.triangle, view.triangles, f->hull[i]);
   r = dn_garment_stage_output(g, &p, &out, f->worn[i], parallel, err);
   if (mesh) {
      memcpy(mesh->bounds_min, out.bounds_min, sizeof out.bounds_min);
      memcpy(mesh->bounds_max, out.bounds_max, sizeof out.bounds_max);
      mesh->fallback_nodes = out.fallback_nodes;
      mesh->collision = found;
   }
   return r;
}
DN_API dn_result dn_dressed_deform(const dn_dressed *d, const dn_dressed_pose *pose, dn_dressed_mesh *body,
                                   dn_dressed_mesh *garment, float *palette, void *scratch, size_t scratch_bytes,
                                   const dn_parallel *parallel, dn_error *err)
{
   dn__arena a = dn__arena_of(scratch, scratch_bytes);
   dn__stroll f;
   dn_rig_view rig;
   dn_result r, worst;
   size_t i, n, need;
   DN_ASSERT(d && d->usable && pose && scratch && ((uintptr_t)scratch & 63) == 0 && (pose->theta || pose->rotations));
   need = dn_dressed_scratch_size(d, dn__workers(parallel));
   if (scratch_bytes < need)
      return dn__fail_sizes(err, DN_TOO_SMALL, dn__where_dressed, SIZE_MAX, "scratch: ", scratch_bytes, " bytes given, needed ", need, NULL);
   dn__stroll_layout(d, &f, dn__workers(parallel), &a);
   memset(f.theta, 0, d->thetas * sizeof(float));
   worst = dn__dressed_pose_body(d, pose, body, &f, parallel, err);
   if (palette) memcpy(palette, f.palette, 12 * d->shape.joints * sizeof(float));
   dn_rig_describe(d->rig, &rig);
   if (f.skin) { /* on nodes: a seam of the mesh is no border of the skin */
      for (n = 0; n < rig.nodes; n++) memcpy(f.nodes + 3 * n, f.body + 3 * (size_t)rig.first_vertex[n], 12);
      dn_surface_build(&f.surface[d->view.garments], f.nodes, rig.nodes, rig.triangle, rig.triangles, f.skin);
   }
   for (i = 0; i < d->view.garments; i++) {
      size_t at = d->order[i];
      r = dn__dressed_wear(d, at, pose, garment ? &garment[at] : NULL, &f, parallel, err);
      if (worst == DN_OK) worst = r;
   }
   return worst;
}

/* ===================================================================================== >>blend
   in       a mesh without a rig; a neuralblendshapes model    out   dn_blend: weights, skeleton, shapes, masks; poses of it
   touches  the memory and scratch handed in; a finished dn_blend is never written again
   paper    N 1-5 and table 5; MeshCNN after Hanocka et al. 2019, skeleton-aware layers after Aberman et al. 2020
   memory   Neighbours of an edge lie anywhere, and the channel pool wants all edges before the next layer starts: so a
            layer runs over all edges before the next one, between two row buffers. Only the widest rows never exist at
            once. geo's last layer (512) feeds sums alone: it runs on pieces of edges. geo2's last feeds a convolution,
            which is linear in its input channels: a slice of 64 of them is made for all edges, multiplied into dec.0's
            256 sums, forgotten. No halo, nothing computed twice: 256 + 256 + 64 floats an edge, 83 MB at 36,000 edges
            where whole rows (256, 512 + 24, 256) would take 151 MB.
   read     dn_meshconv_ref, dn_edges_build, then dn__nbs_run (the network), dn_blend_pose (a frame) */
enum {
   DN__EDGE_TILE = 42,          /* edges: every kernel's tile height divides it or nearly */
   DN__EDGE_PIECE = 24 * DN__EDGE_TILE,
   DN__EDGE_SLICE = 64,         /* channels, a multiple of DN_PANEL */
   DN__EDGE_RUN = 16,           /* terms of a sum */
   DN__BLEND_JOINTS = 1024
};

/* --- edges. The one-rings give every directed edge a slot; `used` there says which edge it became. */
static size_t dn__edge_slot(const dn_graph *g, uint32_t from, uint32_t to) /* of to in from's row: rows ascend */
{
   size_t low = g->first[from], high = g->first[from + 1];
   while (high - low > 1) {
      size_t middle = low + (high - low) / 2;
      if (g->next[middle] <= to) low = middle;
      else high = middle;
   }
   DN_ASSERT(g->next[low] == to);
   return low;
}
static int dn__edge_flat(const float *positions, const uint32_t *t) /* the cross product, in double, is exactly zero */
{
   const float *x = positions + 3 * (size_t)t[0], *y = positions + 3 * (size_t)t[1],
      *z = positions + 3 * (size_t)t[2];
   double u[3], w[3];
   int c;
   if (t[0] == t[1] || t[1] == t[2] || t[2] == t[0]) return 1; /* even where a position is not a number */
   for (c = 0; c < 3; c++) u[c] = (double)y[c] - (double)x[c], w[c] = (double)z[c] - (double)x[c];
   return u[1] * w[2] == u[2] * w[1] && u[2] * w[0] == u[0] * w[2] && u[0] * w[1] == u[1] * w[0];
}
typedef struct dn__edge_work { uint32_t *first, *next, *used; void *graph; } dn__edge_work;
static dn__edge_work dn__edge_layout(dn__arena *a, size_t nodes, size_t triangles)
{
   dn__edge_work w;
   w.first = (uint32_t *)dn__take(a, dn__add(nodes, 1), sizeof(uint32_t));
   w.next = (uint32_t *)dn__take(a, dn__mul(triangles, 6), sizeof(uint32_t));
   w.used = (uint32_t *)dn__take(a, dn__mul(triangles, 6), sizeof(uint32_t));
   w.graph = dn__take(a, dn_graph_scratch(nodes, triangles), 1);
   return w;
}
DN_API size_t dn_edges_scratch(size_t nodes, size_t triangles)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn__edge_layout(&a, nodes, triangles);
   return dn__gauge(&a);
}
DN_API void dn_edges_build(const float *positions, const uint32_t *triangle, size_t triangles, size_t nodes,
                           uint32_t *ends, uint32_t *ring, uint32_t *first, uint32_t *at, uint32_t *skipped,
                           dn_edges *edges, void *scratch)
{
   dn__arena arena = dn__arena_of(scratch, SIZE_MAX);
   dn__edge_work w = dn__edge_layout(&arena, nodes, triangles);
   dn_graph g;
   size_t t, e, i, count = 0, left_out = 0;
   uint32_t total = 0;
   dn_graph_build(triangle, triangles, nodes, w.first, w.next, &g, w.graph);
   memset(w.used, 0xff, g.first[nodes] * sizeof *w.used); /* DN_NO_EDGE */
   for (t = 0; t < triangles; t++) {
      const uint32_t *q = triangle + 3 * t;
      size_t there[3], back[3]; /* slots of each side and of its opposite */
      uint32_t id[3];
      int k, skip = dn__edge_flat(positions, q);
      for (k = 0; k < 3 && !skip; k++) {
         there[k] = dn__edge_slot(&g, q[k], q[(k + 1) % 3]);
         back[k] = dn__edge_slot(&g, q[(k + 1) % 3], q[k]);
         skip = w.used[there[k]] != DN_NO_EDGE;
      }
      if (skip) {
         if (skipped) skipped[left_out] = (uint32_t)t;
         left_out++;
         continue;
      }
      for (k = 0; k < 3; k++) {
         uint32_t a = q[k], b = q[(k + 1) % 3];
         id[k] = w.used[back[k]];
         if (id[k] == DN_NO_EDGE) {
            id[k] = (uint32_t)count++;
            ends[2 * (size_t)id[k]] = a < b ? a : b;
            ends[2 * (size_t)id[k] + 1] = a < b ? b : a;
            ring[4 * (size_t)id[k] + 2] = ring[4 * (size_t)id[k] + 3] = DN_NO_EDGE;
         }
         w.used[there[k]] = id[k];
      }
      for (k = 0; k < 3; k++) { /* going round from this side: the next one, the one after */
         uint32_t *r = ring + 4 * (size_t)id[k] + (w.used[back[k]] == DN_NO_EDGE ? 0 : 2);
         r[0] = id[(k + 1) % 3];
         r[1] = id[(k + 2) % 3];
      }
   }
   memset(first, 0, (nodes + 1) * sizeof *first);
   for (e = 0; e < 2 * count; e++) first[ends[e]]++;
   for (i = 0; i < nodes; i++) { /* counts -> row starts */
      uint32_t n = first[i];
      w.first[i] = first[i] = total;
      total += n;
   }
   first[nodes] = total;
   for (e = 0; e < 2 * count; e++) at[w.first[ends[e]]++] = (uint32_t)(e / 2);
   edges->nodes = nodes;
   edges->count = count;
   edges->ends = ends;
   edges->ring = ring;
   edges->first = first;
   edges->at = at;
   edges->skipped = left_out;
}

/* --- between vertices and edges */
typedef struct dn__edge_mean_job {
   const dn_edges *edges;
   const float *x;
   float *y;
   size_t x_stride, y_stride, width;
} dn__edge_mean_job;
static void dn__vertex_to_edge_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__edge_mean_job *j = (const dn__edge_mean_job *)job;
   size_t e, c;
   (void)worker;
   for (e = begin; e < end; e++) {
      const float *p = j->x + j->edges->ends[2 * e] * j->x_stride,
         *q = j->x + j->edges->ends[2 * e + 1] * j->x_stride;
      for (c = 0; c < j->width; c++) j->y[e * j->y_stride + c] = 0.5f * p[c] + 0.5f * q[c];
   }
}
static void dn__edge_to_vertex_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__edge_mean_job *j = (const dn__edge_mean_job *)job;
   size_t i, c, k;
   (void)worker;
   for (i = begin; i < end; i++) {
      size_t first = j->edges->first[i], last = j->edges->first[i + 1];
      for (c = 0; c < j->width; c++) {
         double sum = 0.0; /* a hub may have thousands */
         for (k = first; k < last; k++) sum += (double)j->x[j->edges->at[k] * j->x_stride + c];
         j->y[i * j->y_stride + c] = first < last ? (float)(sum / (double)(last - first)) : 0.0f;
      }
   }
}
static dn__edge_mean_job dn__edge_mean_of(const dn_edges *edges, const float *x, size_t x_stride, size_t width,
                                          float *y, size_t y_stride)
{
   dn__edge_mean_job j;
   j.edges = edges;
   j.x = x;
   j.y = y;
   j.x_stride = x_stride;
   j.y_stride = y_stride;
   j.width = width;
   return j;
}
DN_API void dn_vertex_to_edge(const dn_edges *edges, const float *v, size_t v_stride, size_t width, float *y,
                              size_t y_stride, const dn_parallel *parallel)
{
   dn__edge_mean_job j = dn__edge_mean_of(edges, v, v_stride, width, y, y_stride);
   dn__for(parallel, edges->count, DN__GRAIN, dn__vertex_to_edge_range, &j);
}
DN_API void dn_edge_to_vertex(const dn_edges *edges, const float *x, size_t x_stride, size_t width, float *y,
                              size_t y_stride, const dn_parallel *parallel)
{
   dn__edge_mean_job j = dn__edge_mean_of(edges, x, x_stride, width, y, y_stride);
   dn__for(parallel, edges->nodes, DN__GRAIN, dn__edge_to_vertex_range, &j);
}

/* --- MeshCNN convolution. A row of 256 channels has 1,280 terms, layers follow each other and weights of either sign
   cancel: added up in float they were off by 3 times the tolerance (spec section 7), in runs of 64 by 0.9 of it. So the
   kernels multiply runs of DN__EDGE_RUN terms and the runs' sums are added in double. Columns go DN__EDGE_SLICE at a time,
   which keeps both in the first-level cache.
   Panels: for each slice of columns, for each run of terms: (columns / 16, terms, 16). */
static size_t dn__conv_block(size_t out, size_t column) /* columns of the slice that starts there, padded */
{
   return dn__round(dn__min(DN__EDGE_SLICE, out - column), DN_PANEL);
}
static float *dn__conv_panel(float *panels, size_t terms, size_t out, size_t term, size_t column) /* one weight's place */
{
   size_t first = column / DN__EDGE_SLICE * DN__EDGE_SLICE, run = term / DN__EDGE_RUN * DN__EDGE_RUN;
   size_t length = dn__min(DN__EDGE_RUN, terms - run), c = column - first;
   return panels + first * terms + run * dn__conv_block(out, first) + (c / DN_PANEL * length + (term - run)) * DN_PANEL + c % DN_PANEL;
}
static void dn__conv_carve(dn__arena *a, size_t in, size_t out, float **panels, float **bias, float **zero)
{
   size_t columns = dn__round(out, DN_PANEL);
   *panels = (float *)dn__take(a, dn__mul(columns, dn__mul(in, 5)), sizeof(float));
   *bias = (float *)dn__take(a, columns, sizeof(float));
   *zero = (float *)dn__take(a, DN__EDGE_SLICE, sizeof(float)); /* what the kernels take for a bias */
}
DN_API size_t dn_meshconv_size(size_t in, size_t out)
{
   dn__arena a = dn__arena_of(NULL, 0);
   float *panels, *bias, *zero;
   dn__conv_carve(&a, in, out, &panels, &bias, &zero);
   return in == 0 || out == 0 || dn__gauge(&a) == SIZE_MAX ? 0 : dn__gauge(&a);
}
/* Channels from .. from + in - 1 of a convolution that has `all`. The first part carries bias and shift; the sum of all
   parts is the layer. File order (out, all, 5) -> terms [x | a + c | b + d | |a - c| | |b - d|], `in` of each. */
static void dn__meshconv_pack_part(dn_meshconv *layer, size_t all, size_t from, size_t in, size_t out,
                                   const float *weight, const float *bias, const dn_batchnorm *bn,
                                   dn_activation activation, void *memory)
{
   dn__arena a = dn__arena_of(memory, SIZE_MAX);
   float *panels, *folded, *zero;
   size_t o, c, k;
   DN_ASSERT(dn_meshconv_size(in, out) != 0 && ((size_t)(uintptr_t)memory & (DN__ALIGN - 1)) == 0);
   dn__conv_carve(&a, in, out, &panels, &folded, &zero);
   memset(memory, 0, dn__gauge(&a)); /* columns past `out` stay zero */
   for (o = 0; o < out; o++) {
      double scale, shift;
      dn__fold(bn, o, &scale, &shift);
      for (c = 0; c < in; c++)
         for (k = 0; k < 5; k++)
            *dn__conv_panel(panels, 5 * in, out, k * in + c, o) =
               dn__narrow(scale * (double)weight[(o * all + from + c) * 5 + k]);
      if (from == 0) folded[o] = dn__narrow(scale * (bias ? (double)bias[o] : 0.0) + shift);
   }
   layer->in = in;
   layer->out = out;
   layer->activation = activation;
   layer->panels = panels;
   layer->bias = folded;
   layer->zero = zero;
   layer->kernel = dn__kernel_best();
}
DN_API void dn_meshconv_pack(dn_meshconv *layer, size_t in, size_t out, const float *weight, const float *bias,
                             const dn_batchnorm *bn, dn_activation activation, void *memory)
{
   dn__meshconv_pack_part(layer, in, 0, in, out, weight, bias, bn, activation, memory);
}
DN_API void dn_meshconv_ref(const dn_meshconv *layer, const dn_edges *edges, const float *x, size_t x_stride,
                            float *y, size_t y_stride)
{
   size_t e, o, n, k, in = layer->in;
   for (e = 0; e < edges->count; e++) {
      float *to = y + e * y_stride;
      for (o = 0; o < layer->out; o++) {
         double sum = (double)layer->bias[o];
         for (n = 0; n < in; n++) {
            float r[4], row[5];
            for (k = 0; k < 4; k++)
               r[k] = edges->ring[4 * e + k] == DN_NO_EDGE ? 0.0f : x[edges->ring[4 * e + k] * x_stride + n];
            row[0] = x[e * x_stride + n];
            row[1] = r[0] + r[2];           /* a + c */
            row[2] = r[1] + r[3];           /* b + d */
            row[3] = DN_FABSF(r[0] - r[2]); /* |a - c| */
            row[4] = DN_FABSF(r[1] - r[3]); /* |b - d| */
            for (k = 0; k < 5; k++)
               sum += (double)row[k] * (double)*dn__conv_panel((float *)layer->panels, 5 * in, layer->out,
                                                               k * in + n, o);
         }
         to[o] = dn__activate((float)sum, layer->activation);
      }
      if (layer->activation == DN_ACT_SOFTMAX) dn__softmax(to, layer->out);
   }
}
typedef struct dn__conv_job {
   const dn_meshconv *layer;
   const dn_edges *edges;
   const float *x;
   float *y;                   /* row 0 is edge `first`, column 0 is column `column` */
   size_t x_stride, y_stride, first, column, columns;
   unsigned char *tile;        /* (workers, tile_bytes) */
   size_t tile_bytes;
   int add;                    /* y += instead of y = */
   dn_activation activation;
} dn__conv_job;
typedef struct dn__conv_work {
   float *zero;                /* (in) a neighbour that is not there */
   float *rows;                /* (DN__EDGE_TILE, 5 in) */
   float *products;            /* (DN__EDGE_TILE, DN__EDGE_SLICE) of one run */
   double *sums;               /* the same */
} dn__conv_work;
static dn__conv_work dn__conv_layout(dn__arena *a, size_t in)
{
   dn__conv_work w;
   w.zero = (float *)dn__take(a, in, sizeof(float));
   w.rows = (float *)dn__take(a, dn__mul(dn__mul(in, 5), DN__EDGE_TILE), sizeof(float));
   w.products = (float *)dn__take(a, DN__EDGE_TILE * DN__EDGE_SLICE, sizeof(float));
   w.sums = (double *)dn__take(a, DN__EDGE_TILE * DN__EDGE_SLICE, sizeof(double));
   return w;
}
static size_t dn__conv_bytes(size_t in) /* of one worker */
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn__conv_layout(&a, in);
   return dn__gauge(&a);
}
static void dn__conv_rows(const dn__conv_job *j, const dn__conv_work *w, size_t first, size_t count) /* [x, a+c, b+d, |a-c|, |b-d|] */
{
   size_t e, c, in = j->layer->in;
   float *row = w->rows;
   for (e = first; e < first + count; e++, row += 5 * in) {
      const uint32_t *ring = j->edges->ring + 4 * e;
      const float *p = ring[0] == DN_NO_EDGE ? w->zero : j->x + ring[0] * j->x_stride;
      const float *q = ring[1] == DN_NO_EDGE ? w->zero : j->x + ring[1] * j->x_stride;
      const float *r = ring[2] == DN_NO_EDGE ? w->zero : j->x + ring[2] * j->x_stride;
      const float *s = ring[3] == DN_NO_EDGE ? w->zero : j->x + ring[3] * j->x_stride;
      memcpy(row, j->x + e * j->x_stride, in * sizeof *row);
      for (c = 0; c < in; c++) row[in + c] = p[c] + r[c];
      for (c = 0; c < in; c++) row[2 * in + c] = q[c] + s[c];
      for (c = 0; c < in; c++) row[3 * in + c] = DN_FABSF(p[c] - r[c]);
      for (c = 0; c < in; c++) row[4 * in + c] = DN_FABSF(q[c] - s[c]);
   }
}
/* one tile's rows times one slice of columns -> sums (count, columns, padded) */
static size_t dn__conv_slice(const dn_meshconv *l, const dn__conv_work *w, size_t column, size_t count)
{
   size_t terms = 5 * l->in, columns = dn__conv_block(l->out, column), i, c, run;
   dn_linear part;
   part.out = columns;
   part.activation = DN_ACT_NONE;
   part.panels = l->panels + column * terms;
   part.columns = part.add = NULL; /* plain sums */
   part.kernel = l->kernel;
   for (i = 0; i < count; i++)
      for (c = 0; c < columns; c++) w->sums[i * columns + c] = (double)l->bias[column + c];
   for (run = 0; run < terms; run += DN__EDGE_RUN) {
      part.in = dn__min(DN__EDGE_RUN, terms - run);
      dn__product(&part, w->rows + run, terms, w->products, columns, 0, count);
      for (i = 0; i < count * columns; i += DN_PANEL)
         for (c = 0; c < DN_PANEL; c++) w->sums[i + c] += (double)w->products[i + c];
      part.panels += columns * part.in;
   }
   return columns;
}
static void dn__conv_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__conv_job *j = (const dn__conv_job *)job;
   const dn_meshconv *l = j->layer;
   dn__arena a = dn__arena_of(j->tile + worker * j->tile_bytes, j->tile_bytes);
   dn__conv_work w = dn__conv_layout(&a, l->in);
   size_t n, i, c, column, padded, columns;
   memset(w.zero, 0, l->in * sizeof *w.zero);
   for (; begin < end; begin += n) {
      n = dn__min(DN__EDGE_TILE, end - begin);
      dn__conv_rows(j, &w, j->first + begin, n);
      for (column = j->column; column < j->column + j->columns; column += columns) {
         padded = dn__conv_slice(l, &w, column, n);
         columns = dn__min(DN__EDGE_SLICE, l->out - column);
         for (i = 0; i < n; i++) {
            float *to = j->y + (begin + i) * j->y_stride + (column - j->column);
            const double *sum = w.sums + i * padded;
            for (c = 0; c < columns; c++)
               to[c] = dn__activate((float)(j->add ? (double)to[c] + sum[c] : sum[c]), j->activation);
         }
      }
      for (i = 0; j->activation == DN_ACT_SOFTMAX && i < n; i++)
         dn__softmax(j->y + (begin + i) * j->y_stride, l->out);
   }
}
static dn__conv_job dn__conv_of(const dn_meshconv *layer, const dn_edges *edges, const float *x, size_t x_stride,
                                float *y, size_t y_stride, void *scratch)
{
   dn__conv_job j;
   j.layer = layer;
   j.edges = edges;
   j.x = x;
   j.y = y;
   j.x_stride = x_stride;
   j.y_stride = y_stride;
   j.first = j.column = 0;
   j.columns = layer->out;
   j.tile = (unsigned char *)scratch;
   j.tile_bytes = dn__conv_bytes(layer->in);
   j.add = 0;
   j.activation = layer->activation;
   return j;
}
DN_API size_t dn_meshconv_scratch(const dn_meshconv *layer, unsigned workers)
{
   return dn__mul(dn__conv_bytes(layer->in), workers ? workers : 1);
}
DN_API void dn_meshconv_run(const dn_meshconv *layer, const dn_edges *edges, const float *x, size_t x_stride,
                            float *y, size_t y_stride, void *scratch, const dn_parallel *parallel)
{
   dn__conv_job j = dn__conv_of(layer, edges, x, x_stride, y, y_stride, scratch);
   dn__for(parallel, edges->count, DN__EDGE_TILE, dn__conv_range, &j);
}

/* --- channel pool, softmax, skinning-based pooling */
typedef struct dn__edge_rows_job { float *x; size_t stride, width; } dn__edge_rows_job;
static void dn__edge_spread_range(void *job, size_t begin, size_t end, unsigned worker) /* row 0 to all others */
{
   const dn__edge_rows_job *j = (const dn__edge_rows_job *)job;
   (void)worker;
   for (begin = dn__max(begin, 1); begin < end; begin++)
      memcpy(j->x + begin * j->stride, j->x, j->width * sizeof *j->x);
}
DN_API void dn_channel_pool(float *x, size_t x_stride, size_t rows, size_t channels, const dn_parallel *parallel)
{
   dn__edge_rows_job j;
   size_t r, c;
   j.x = x;
   j.stride = x_stride;
   j.width = channels / 5;
   for (r = 1; r < rows; r++) /* the maxima gather in row 0 */
      for (c = 0; c < j.width; c++)
         if (x[r * x_stride + c] > x[c]) x[c] = x[r * x_stride + c];
   dn__for(parallel, rows, DN__GRAIN, dn__edge_spread_range, &j);
}
static void dn__edge_softmax_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__edge_rows_job *j = (const dn__edge_rows_job *)job;
   (void)worker;
   for (; begin < end; begin++) dn__softmax(j->x + begin * j->stride, j->width);
}
DN_API void dn_edge_softmax(float *x, size_t x_stride, size_t rows, size_t width, const dn_parallel *parallel)
{
   dn__edge_rows_job j;
   j.x = x;
   j.stride = x_stride;
   j.width = width;
   dn__for(parallel, rows, DN__GRAIN, dn__edge_softmax_range, &j);
}
/* sum_e A_ej x_e of `count` edges for joints begin to end - 1, added to sums (J,width+1), the last of a row sum_e A_ej.
   Edges in order whatever the ranges are: pieces one after the other are one long run. */
typedef struct dn__skin_pool_job { const float *attention, *x; double *sums; size_t joints, x_stride, count, width; } dn__skin_pool_job;
static void dn__skin_pool_add_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__skin_pool_job *j = (const dn__skin_pool_job *)job;
   size_t joint, e, c;
   (void)worker;
   for (joint = begin; joint < end; joint++) {
      double *sum = j->sums + joint * (j->width + 1);
      for (e = 0; e < j->count; e++) {
         double a = (double)j->attention[e * j->joints + joint];
         const float *x = j->x + e * j->x_stride;
         for (c = 0; c < j->width; c++) sum[c] += a * (double)x[c];
         sum[j->width] += a;
      }
   }
}
static float dn__skin_pool_divide(double sum, double total) { return (float)(sum / (total < 1e-10 ? 1.0 : total)); } /* N 1 */
typedef struct dn__skin_pooled_job { dn__skin_pool_job pool; float *y; } dn__skin_pooled_job;
static void dn__skin_pooled_range(void *job, size_t begin, size_t end, unsigned worker) /* a joint's columns, 31 at a time */
{
   enum { COLUMNS = 31 };
   const dn__skin_pooled_job *j = (const dn__skin_pooled_job *)job;
   size_t joint, c, k;
   for (joint = begin; joint < end; joint++)
      for (c = 0; c < j->pool.width; c += COLUMNS) {
         double sums[COLUMNS + 1];
         dn__skin_pool_job part = j->pool;
         memset(sums, 0, sizeof sums);
         part.width = dn__min(COLUMNS, j->pool.width - c);
         part.x += c;
         part.attention += joint;
         part.sums = sums;
         dn__skin_pool_add_range(&part, 0, 1, worker);
         for (k = 0; k < part.width; k++)
            j->y[joint * j->pool.width + c + k] = dn__skin_pool_divide(sums[k], sums[part.width]);
      }
}
DN_API void dn_skinning_pool(const float *attention, size_t joints, const float *x, size_t x_stride, size_t edges,
                             size_t width, float *y, const dn_parallel *parallel)
{
   dn__skin_pooled_job j;
   j.pool.attention = attention;
   j.pool.x = x;
   j.pool.sums = NULL;
   j.pool.joints = joints;
   j.pool.x_stride = x_stride;
   j.pool.count = edges;
   j.pool.width = width;
   j.y = y;
   dn__for(parallel, joints, 1, dn__skin_pooled_range, &j);
}

/* --- skeleton-aware layers. A matrix is read once, so memory sets the pace, not arithmetic: dot products in double,
   four sums wide, need no panels, and out = 3 is not padded to 16. */
static int dn__joint_sees(const int32_t *parents, size_t a, size_t b) /* at most 2 steps apart in the tree */
{
   int32_t pa = parents[a], pb = parents[b], i = (int32_t)a, j = (int32_t)b;
   if (i == j || pa == j || pb == i || (pa >= 0 && pa == pb)) return 1;
   return (pa >= 0 && parents[pa] == j) || (pb >= 0 && parents[pb] == i);
}
static void dn__skeleton_carve(dn__arena *a, const int32_t *parents, size_t joints, size_t in, size_t out,
                               uint32_t **first, uint32_t **sees, float **weight, float **bias)
{
   size_t j, k, pairs = 0;
   for (j = 0; j < joints; j++)
      for (k = 0; k < joints; k++) pairs += (size_t)dn__joint_sees(parents, j, k);
   *first = (uint32_t *)dn__take(a, dn__add(joints, 1), sizeof(uint32_t));
   *sees = (uint32_t *)dn__take(a, pairs, sizeof(uint32_t));
   *weight = (float *)dn__take(a, dn__mul(dn__mul(in, out), pairs), sizeof(float));
   *bias = (float *)dn__take(a, dn__mul(joints, out), sizeof(float));
}
DN_API size_t dn_skeleton_linear_size(const int32_t *parents, size_t joints, size_t in, size_t out)
{
   dn__arena a = dn__arena_of(NULL, 0);
   uint32_t *first, *sees;
   float *weight, *bias;
   if (joints == 0 || in == 0 || out == 0 || joints > 0x7fffffff) return 0;
   dn__skeleton_carve(&a, parents, joints, in, out, &first, &sees, &weight, &bias);
   return dn__gauge(&a) == SIZE_MAX ? 0 : dn__gauge(&a);
}
/* The blocks come from a matrix in memory or straight from a file, which then is never held as floats; rows are scaled by
   a batch norm over J out channels. Returns the element that is not finite, or SIZE_MAX. */
static size_t dn__skeleton_pack(dn_skeleton_linear *layer, const int32_t *parents, size_t joints, size_t in,
                                size_t out, const float *weight, const dn_tensor *file, const float *bias,
                                const dn_batchnorm *bn, dn_activation activation, void *memory)
{
   dn__arena a = dn__arena_of(memory, SIZE_MAX);
   uint32_t *first, *sees;
   float *kept, *folded;
   size_t j, k, o, c, pairs = 0;
   dn__skeleton_carve(&a, parents, joints, in, out, &first, &sees, &kept, &folded);
   for (j = 0; j < joints; j++) {
      first[j] = (uint32_t)pairs;
      for (k = 0; k < joints; k++)
         if (dn__joint_sees(parents, j, k)) sees[pairs++] = (uint32_t)k;
   }
   first[joints] = (uint32_t)pairs;
   layer->joints = joints;
   layer->in = in;
   layer->out = out;
   layer->activation = activation;
   layer->first = first;
   layer->sees = sees;
   layer->weight = kept;
   layer->bias = folded;
   for (j = 0; j < joints; j++)
      for (o = 0; o < out; o++) {
         double scale, shift;
         dn__fold(bn, j * out + o, &scale, &shift);
         for (k = first[j]; k < first[j + 1]; k++, kept += in) {
            size_t from = ((j * out + o) * joints + sees[k]) * in;
            if (file) dn_tensor_floats(file, from, in, kept);
            else memcpy(kept, weight + from, in * sizeof *kept);
            for (c = 0; c < in; c++) {
               if (file && !dn__finite(kept[c])) return from + c;
               if (bn) kept[c] = dn__narrow(scale * (double)kept[c]);
            }
         }
         folded[j * out + o] = dn__narrow(scale * (bias ? (double)bias[j * out + o] : 0.0) + shift);
      }
   return SIZE_MAX;
}
DN_API void dn_skeleton_linear_pack(dn_skeleton_linear *layer, const int32_t *parents, size_t joints, size_t in,
                                    size_t out, const float *weight, const float *bias, dn_activation activation,
                                    void *memory)
{
   DN_ASSERT(dn_skeleton_linear_size(parents, joints, in, out) != 0 && activation != DN_ACT_SOFTMAX);
   dn__skeleton_pack(layer, parents, joints, in, out, weight, NULL, bias, NULL, activation, memory);
}
DN_API void dn_skeleton_linear_ref(const int32_t *parents, size_t joints, size_t in, size_t out, const float *weight,
                                   const float *bias, dn_activation activation, const float *x, float *y)
{
   size_t j, o, k, c;
   for (j = 0; j < joints; j++)
      for (o = 0; o < out; o++) {
         const float *w = weight + (j * out + o) * joints * in; /* (J, in) */
         double sum = bias ? (double)bias[j * out + o] : 0.0;
         for (k = 0; k < joints; k++)
            for (c = 0; c < in && dn__joint_sees(parents, j, k); c++)
               sum += (double)w[k * in + c] * (double)x[k * in + c];
         y[j * out + o] = dn__activate((float)sum, activation);
      }
}
typedef struct dn__skeleton_job { const dn_skeleton_linear *layer; const float *x; float *y; } dn__skeleton_job;
static void dn__skeleton_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__skeleton_job *s = (const dn__skeleton_job *)job;
   const dn_skeleton_linear *l = s->layer;
   size_t j, o, k, c, in = l->in;
   (void)worker;
   for (j = begin; j < end; j++) {
      const float *w = l->weight + in * l->out * l->first[j];
      for (o = 0; o < l->out; o++) {
         double a = (double)l->bias[j * l->out + o], b = 0.0, d = 0.0, e = 0.0;
         for (k = l->first[j]; k < l->first[j + 1]; k++, w += in) {
            const float *x = s->x + l->sees[k] * in;
            for (c = 0; c + 4 <= in; c += 4) {
               a += (double)w[c] * (double)x[c];
               b += (double)w[c + 1] * (double)x[c + 1];
               d += (double)w[c + 2] * (double)x[c + 2];
               e += (double)w[c + 3] * (double)x[c + 3];
            }
            for (; c < in; c++) a += (double)w[c] * (double)x[c];
         }
         s->y[j * l->out + o] = dn__activate((float)(a + b + (d + e)), l->activation);
      }
   }
}
DN_API void dn_skeleton_linear_run(const dn_skeleton_linear *layer, const float *x, float *y,
                                   const dn_parallel *parallel)
{
   dn__skeleton_job j;
   j.layer = layer;
   j.x = x;
   j.y = y;
   dn__for(parallel, layer->joints, 1, dn__skeleton_range, &j);
}

/* --- the model. Chains may be longer or shorter than the paper's; what joins them must fit. */
typedef enum dn__nbs_branch { DN__ATT, DN__GEO, DN__GEO2, DN__DEC, DN__BRANCHES } dn__nbs_branch;
static const char *const dn__nbs_branch_names[] = { "att.", "geo.", "geo2.", "dec." };
struct dn__blend_net {
   size_t joints, shapes;         /* S, B */
   size_t count[DN__BRANCHES];    /* layers of each branch, at least 1 */
   dn_meshconv *conv[DN__BRANCHES]; /* dec.0 lies in slice */
   size_t slices;                 /* of dec.0's input: geo2's channels, DN__EDGE_SLICE at a time, then the attention */
   dn_meshconv *slice;            /* without activation: it follows the sum */
   dn_activation joined;          /* dec.0's */
   size_t gen_count;
   dn_skeleton_linear *gen;
   size_t coff_count, coff_width; /* layers of each joint's MLP; its widest row */
   dn_linear *coff;               /* (S-1, coff_count) */
   const int32_t *parents;        /* (S) */
};

/* how many of STEM0.weight, STEM1.weight ... there are; none is an error that names the first */
static size_t dn__count_chain(dn__loader *l, const char *stem)
{
   size_t n;
   char name[DN__NAME];
   for (n = 0; n < DN__MAX_CHAIN; n++) {
      dn__number(name, sizeof name, stem, n, ".weight");
      if (!dn_tensors_find(l->file, name)) break;
   }
   dn__number(name, sizeof name, stem, n, ".weight");
   if (n == 0) dn__load_fail(l, DN_MISSING_TENSOR, name, ": not in the file");
   if (n == DN__MAX_CHAIN && dn_tensors_find(l->file, name))
      dn__load_fail(l, DN_UNSUPPORTED, name, ": more than 64 layers of one kind");
   return n;
}
/* name.weight (out,in,1,5) with that `in`, any out that fits; out = 0 accepts any */
static const dn_tensor *dn__want_conv(dn__loader *l, const char *name, size_t in, size_t out)
{
   char full[DN__NAME + 24], text[160];
   dn__text s = dn__text_of(text, sizeof text);
   const dn_tensor *t;
   if (l->failed) return NULL;
   dn__join(full, sizeof full, name, ".weight");
   t = dn_tensors_find(l->file, full);
   if (!t) {
      dn__load_fail(l, DN_MISSING_TENSOR, full, ": not in the file");
      return NULL;
   }
   if (t->rank != 4 || t->shape[0] < 1 || t->shape[0] > DN_MAX_DIM || (out && t->shape[0] != out) ||
       t->shape[1] != in || t->shape[2] != 1 || t->shape[3] != 5) {
      dn__put(&s, ": expected (");
      if (out) dn__put_size(&s, out);
      else dn__put(&s, "1..max");
      dn__put(&s, ",");
      dn__put_size(&s, in);
      dn__put(&s, ",1,5), file has ");
      dn__put_shape(&s, t->shape, t->rank);
      dn__load_fail(l, DN_BAD_SHAPE, full, text);
      return NULL;
   }
   if (t->format != DN_ST_F32 && t->format != DN_ST_F16 && t->format != DN_ST_BF16) {
      dn__load_fail(l, DN_BAD_TYPE, full, ": expected F32, F16 or BF16, file has another type");
      return NULL;
   }
   return t;
}
static const float *dn__bias_of(dn__loader *l, const char *name, size_t width)
{
   char full[DN__NAME + 24];
   dn__join(full, sizeof full, name, ".bias");
   return dn__floats(l, dn__want(l, full, 1, width, 0));
}
/* one convolution; its first `sliced` input channels are packed DN__EDGE_SLICE at a time, each a layer, the rest as one */
static size_t dn__load_nbs_conv(dn__loader *l, const char *name, size_t in, size_t out, dn_activation act,
                                dn_meshconv *layer, size_t sliced)
{
   const dn_tensor *t = dn__want_conv(l, name, in, out);
   const float *weight, *bias;
   dn_batchnorm bn;
   int has_bn;
   size_t from, width;
   if (!t) return 0;
   l->temp.used = 0;
   out = t->shape[0];
   weight = dn__floats(l, t);
   bias = dn__bias_of(l, name, out);
   has_bn = dn__batchnorm(l, name, out, &bn);
   for (from = 0; from < in && !l->failed; from += width) {
      void *memory;
      size_t bytes;
      width = from < sliced ? dn__min(DN__EDGE_SLICE, sliced - from) : in - from;
      bytes = dn_meshconv_size(width, out);
      memory = dn__take(&l->memory, bytes ? bytes : SIZE_MAX, 1);
      if (l->packing && !l->failed) {
         dn__meshconv_pack_part(layer, in, from, width, out, weight, bias, has_bn ? &bn : NULL,
                                sliced ? DN_ACT_NONE : act, memory);
         layer++->kernel = l->kernel;
      }
   }
   return out;
}
/* a branch: `in` wide rows in; out = 0 accepts any width of the last layer. Returns that width */
static size_t dn__load_nbs_branch(dn__loader *l, struct dn__blend_net *net, dn__nbs_branch branch, size_t in,
                                  size_t out, size_t sliced)
{
   size_t i, n = net->count[branch];
   for (i = 0; i < n && !l->failed; i++) {
      char name[DN__NAME];
      dn_activation act = i + 1 < n ? DN_ACT_LEAKYRELU : DN_ACT_NONE;
      int parts = sliced && i == 0;
      dn__number(name, sizeof name, dn__nbs_branch_names[branch], i, "");
      if (parts) net->joined = act;
      in = dn__load_nbs_conv(l, name, in, i + 1 < n ? 0 : out, act,
                             !l->packing ? NULL : parts ? net->slice : net->conv[branch] + i, parts ? sliced : 0);
   }
   return in;
}
/* gen.N: per joint `in` wide rows in, three numbers out of the last; straight from the file into its blocks */
static void dn__load_nbs_gen(dn__loader *l, struct dn__blend_net *net, const int32_t *parents, size_t in)
{
   size_t i, out, bad, bytes, joints = net->joints;
   for (i = 0; i < net->gen_count && !l->failed; i++) {
      char name[DN__NAME], full[DN__NAME + 24];
      const dn_tensor *t;
      const float *bias;
      dn_batchnorm bn;
      void *memory;
      int has_bn, last = i + 1 == net->gen_count;
      dn__number(name, sizeof name, "gen.", i, "");
      dn__join(full, sizeof full, name, ".weight");
      t = dn__want(l, full, 2, last ? 3 * joints : 0, dn__mul(joints, in));
      if (!t) return;
      if (t->shape[0] % joints) {
         char text[120];
         dn__text s = dn__text_of(text, sizeof text);
         dn__put(&s, ": expected a multiple of the ");
         dn__put_size(&s, joints);
         dn__put(&s, " joints in rows, file has ");
         dn__put_size(&s, t->shape[0]);
         dn__load_fail(l, DN_BAD_SHAPE, full, text);
         return;
      }
      out = t->shape[0] / joints;
      l->temp.used = 0;
      bias = dn__bias_of(l, name, joints * out);
      has_bn = dn__batchnorm(l, name, joints * out, &bn);
      bytes = dn_skeleton_linear_size(parents, joints, in, out);
      memory = dn__take(&l->memory, bytes ? bytes : SIZE_MAX, 1);
      l->model->info.parameters = dn__add(l->model->info.parameters, t->count);
      if (l->packing && !l->failed) {
         bad = dn__skeleton_pack(&net->gen[i], parents, joints, in, out, NULL, t, bias, has_bn ? &bn : NULL,
                                 last ? DN_ACT_NONE : DN_ACT_LEAKYRELU, memory);
         if (bad != SIZE_MAX) {
            char text[80];
            dn__number(text, sizeof text, ": element ", bad, " is not finite");
            dn__load_fail(l, DN_BAD_VALUE, full, text);
         }
      }
      in = out;
   }
}
/* coff.J.N: nine numbers in, B out */
static void dn__load_nbs_coff(dn__loader *l, struct dn__blend_net *net)
{
   size_t j, i, in, widest = 9;
   for (j = 0; j + 1 < net->joints; j++)
      for (in = 9, i = 0; i < net->coff_count; i++) {
         char name[DN__NAME], full[DN__NAME + 24];
         const dn_tensor *t;
         const float *weight, *bias = NULL;
         dn_batchnorm bn;
         int has_bn, last = i + 1 == net->coff_count;
         void *memory;
         size_t out;
         dn__number(name, sizeof name, "coff.", j, ".");
         dn__number(name + strlen(name), sizeof name - strlen(name), "", i, "");
         dn__join(full, sizeof full, name, ".weight");
         t = dn__want(l, full, 2, last ? net->shapes : 0, in);
         if (!t) return;
         out = t->shape[0];
         l->temp.used = 0;
         weight = dn__floats(l, t);
         dn__join(full, sizeof full, name, ".bias");
         if (dn_tensors_find(l->file, full)) bias = dn__floats(l, dn__want(l, full, 1, out, 0));
         has_bn = dn__batchnorm(l, name, out, &bn);
         memory = dn__take(&l->memory, dn_linear_size(in, out), 1);
         if (l->failed) return;
         if (l->packing) {
            dn_linear *layer = &net->coff[j * net->coff_count + i];
            dn_linear_pack(layer, in, out, weight, bias, has_bn ? &bn : NULL, last ? DN_ACT_NONE : DN_ACT_LEAKYRELU,
                           memory);
            layer->kernel = l->kernel;
         }
         widest = dn__max(widest, out);
         in = out;
      }
   net->coff_width = widest;
}
/* "-1,0,0,1": joint 0 is the root, every other joint comes after its parent. Returns S, 0 after an error */
static size_t dn__load_nbs_parents(dn__loader *l, int32_t parents[DN__BLEND_JOINTS])
{
   static const char key[] = "deformnet.parents";
   const char *s = dn__meta(l, key, NULL), *at = s;
   size_t n = 0;
   while (at && !l->failed) {
      size_t value = 0, digits = 0;
      int root = at[0] == '-' && at[1] == '1';
      if (root) at += 2;
      else
         for (; *at >= '0' && *at <= '9' && digits < 6; at++, digits++) value = value * 10 + (size_t)(*at - '0');
      if (n == DN__BLEND_JOINTS) dn__load_fail(l, DN_UNSUPPORTED, key, ": more than 1024 joints");
      else if ((*at && *at != ',') || (n == 0 ? !root : root || digits == 0 || value >= n)) {
         char line[160];
         dn__number(line, sizeof line, ": joint ", n,
                    n ? " does not name a joint before it; expected a list such as -1,0,0,1"
                    : " is not -1, the root; expected a list such as -1,0,0,1");
         dn__load_fail(l, DN_BAD_VALUE, key, line);
      } else parents[n++] = root ? -1 : (int32_t)value;
      at = *at ? at + 1 : NULL;
   }
   return l->failed ? 0 : n;
}
/* N table 5 */
static void dn__build_blend(dn__loader *l)
{
   struct dn__blend_net stand_in, *net = (struct dn__blend_net *)dn__take(&l->memory, 1,
                                                                          sizeof(struct dn__blend_net));
   int32_t parents[DN__BLEND_JOINTS], *kept;
   size_t i, deep, deep2, names, joints = dn__load_nbs_parents(l, parents);
   if (!l->packing) net = &stand_in;
   memset(net, 0, sizeof *net);
   l->model->blend = l->packing ? net : NULL;
   net->joints = joints;
   for (i = 0; i < DN__BRANCHES; i++) {
      net->count[i] = dn__count_chain(l, dn__nbs_branch_names[i]);
      net->conv[i] = (dn_meshconv *)dn__take(&l->memory, net->count[i], sizeof(dn_meshconv));
   }
   net->gen_count = dn__count_chain(l, "gen.");
   net->gen = (dn_skeleton_linear *)dn__take(&l->memory, net->gen_count, sizeof(dn_skeleton_linear));
   net->coff_count = joints > 1 ? dn__count_chain(l, "coff.0.") : 0;
   net->coff = (dn_linear *)dn__take(&l->memory, dn__mul(joints, net->coff_count), sizeof(dn_linear));
   kept = (int32_t *)dn__take(&l->memory, joints, sizeof *kept);
   net->parents = kept;
   if (l->failed) return;
   if (l->packing) memcpy(kept, parents, joints * sizeof *kept);
   dn__load_nbs_branch(l, net, DN__ATT, 3, joints, 0);
   deep = dn__load_nbs_branch(l, net, DN__GEO, 3, 0, 0);
   dn__load_nbs_gen(l, net, parents, deep);
   deep2 = dn__load_nbs_branch(l, net, DN__GEO2, 3, 0, 0);
   net->slices = (deep2 + DN__EDGE_SLICE - 1) / DN__EDGE_SLICE + 1;
   net->slice = (dn_meshconv *)dn__take(&l->memory, net->slices, sizeof(dn_meshconv));
   net->shapes = dn__load_nbs_branch(l, net, DN__DEC, deep2 + joints, 0, deep2);
   if (l->failed) return;
   if (net->shapes % 3) {
      char name[DN__NAME], text[120];
      dn__number(name, sizeof name, "dec.", net->count[DN__DEC] - 1, ".weight");
      dn__number(text, sizeof text, ": expected a multiple of 3 rows, x y z of each shape, file has ", net->shapes,
                 "");
      dn__load_fail(l, DN_BAD_SHAPE, name, text);
      return;
   }
   net->shapes /= 3;
   dn__load_nbs_coff(l, net);
   names = l->failed ? 0 : dn__load_joint_names(l);
   if (names && names != joints) {
      char text[120];
      dn__text t = dn__text_of(text, sizeof text);
      dn__put(&t, ": names ");
      dn__put_size(&t, names);
      dn__put(&t, " joints, deformnet.parents has ");
      dn__put_size(&t, joints);
      dn__load_fail(l, DN_BAD_SHAPE, "deformnet.joints", text);
   }
   l->model->info.joints = joints;
}

/* --- binding */
struct dn_blend {
   const dn_model *model;
   dn_blend_view view;
   dn_allocator allocator;
   const dn_allocator *allocator_used; /* NULL: DN_MALLOC, or &allocator */
   int owned;
   const float *rest_vertices;         /* (V,3): with a weld distance, vertices of a node rest apart */
   const uint32_t *joint;              /* (S) 0 1 2 ..: the joints of every row of weights */
};
typedef struct dn__nbs_bind {          /* one call of create or init */
   const struct dn__blend_net *net;
   const dn_model *model;
   const dn_blend_desc *desc;
   dn_error *err;
   size_t vertices, triangles, nodes, edges; /* the last two bounds, until the mesh has been looked at */
   double done, all;                   /* multiplications, for the progress */
   /* the mesh */
   float *positions;                   /* (V,3) */
   float *rest;                        /* (N,3) */
   uint32_t *node_of_vertex, *first_vertex; /* (V) */
   uint32_t *triangle;                 /* (T,3) nodes */
   uint32_t *ends, *ring, *first, *at; /* of mesh */
   dn_edges mesh;
   void *work;
   /* the network; G = width of a branch's last layer */
   float *middle;                      /* (E,3) edge midpoints: what every branch starts from */
   float *rows[2];                     /* (E, widest even layer), (E, widest odd layer) */
   float *attention;                   /* (E,S) */
   float *piece;                       /* (at most DN__EDGE_PIECE, G of geo) */
   double *sums;                       /* (S, G + 1) */
   float *joint_rows[2];               /* (S, widest of gen) */
   float *slice;                       /* (E, DN__EDGE_SLICE or G of geo2) */
   float *probed;                      /* (E, G of geo2) */
   unsigned char *tile;                /* (workers, tile_bytes) */
   size_t width[2], tile_bytes;
} dn__nbs_bind;

static const char dn__where_blend[] = "blend";
static dn_result dn__nbs_open(dn__nbs_bind *b, const dn_model *model, const dn_blend_desc *desc, dn_error *err)
{
   const dn_mesh *m = &desc->mesh;
   DN_ASSERT(model);
   memset(b, 0, sizeof *b);
   b->model = model;
   b->net = model->blend;
   b->desc = desc;
   b->err = err;
   b->vertices = m->vertices;
   b->triangles = m->triangles;
   if (!b->net) {
      char line[160];
      dn__text t = dn__text_of(line, sizeof line);
      dn__put(&t, "the model is a ");
      dn__put(&t, model->info.arch_name);
      dn__put(&t, ", expected neuralblendshapes; ");
      dn__put(&t, model->info.arch <= DN_MULTIRESGNET ? "dn_rig_create takes it" : "dn_garment_create takes it");
      return dn__fail(err, DN_UNSUPPORTED, dn__where_blend, SIZE_MAX, line);
   }
   if (m->vertices == 0) return dn__fail(err, DN_BAD_MESH, dn__where_blend, SIZE_MAX, "no vertices");
   if (m->vertices > DN__MOST || m->triangles > DN__MOST)
      return dn__fail_sizes(err, DN_BAD_MESH, dn__where_blend, SIZE_MAX,
                            m->vertices > DN__MOST ? "vertices: found " : "triangles: found ",
                            m->vertices > DN__MOST ? m->vertices : m->triangles, ", expected at most ", DN__MOST,
                            NULL);
   if (dn__mul(m->vertices, b->net->joints) >= 0xffffffffu) /* mask_first counts pairs of them */
      return dn__fail_sizes(err, DN_BAD_MESH, dn__where_blend, SIZE_MAX, "vertices: found ", m->vertices,
                            ", expected fewer than 2^32 - 1 with each of the joints, which are ", b->net->joints,
                            NULL);
   if (!dn__finite(desc->weld_distance))
      return dn__fail(err, DN_BAD_VALUE, dn__where_blend, SIZE_MAX, "weld_distance is not finite");
   DN_ASSERT(m->positions && (m->triangles == 0 || m->indices));
   DN_ASSERT(m->triangles == 0 || m->index_type == DN_U16 || m->index_type == DN_U32);
   b->nodes = b->vertices;
   b->edges = dn__mul(b->triangles, 3);
   return DN_OK;
}
/* --- layouts: the mesh from its counts, the network's rows and what is kept from nodes and edges */
static void dn__nbs_mesh_layout(dn__nbs_bind *b, dn__arena *a)
{
   size_t V = b->vertices, T = b->triangles, cap = dn__mul(T, 3);
   b->positions = (float *)dn__take(a, dn__mul(V, 3), sizeof(float));
   b->rest = (float *)dn__take(a, dn__mul(V, 3), sizeof(float));
   b->node_of_vertex = (uint32_t *)dn__take(a, V, sizeof(uint32_t));
   b->first_vertex = (uint32_t *)dn__take(a, V, sizeof(uint32_t));
   b->triangle = (uint32_t *)dn__take(a, cap, sizeof(uint32_t));
   b->ends = (uint32_t *)dn__take(a, dn__mul(cap, 2), sizeof(uint32_t));
   b->ring = (uint32_t *)dn__take(a, dn__mul(cap, 4), sizeof(uint32_t));
   b->first = (uint32_t *)dn__take(a, dn__add(V, 1), sizeof(uint32_t));
   b->at = (uint32_t *)dn__take(a, dn__mul(cap, 2), sizeof(uint32_t));
   b->work = dn__take(a, dn__max(dn_weld_scratch(V), dn_edges_scratch(V, T)), 1);
}
static size_t dn__nbs_branch_width(const struct dn__blend_net *net, dn__nbs_branch branch) /* of its last layer */
{
   if (branch == DN__DEC) return 3 * net->shapes;
   return net->conv[branch][net->count[branch] - 1].out;
}
static void dn__nbs_net_layout(dn__nbs_bind *b, dn__arena *a)
{
   const struct dn__blend_net *net = b->net;
   size_t E = b->edges, deep = dn__nbs_branch_width(net, DN__GEO), deep2 = dn__nbs_branch_width(net, DN__GEO2),
      widest = deep, i, k;
   int branch;
   b->width[0] = b->width[1] = b->tile_bytes = 0;
   for (branch = 0; branch < DN__DEC; branch++) /* the last layers go elsewhere */
      for (i = 0; i < net->count[branch]; i++) {
         if (i + 1 < net->count[branch]) b->width[i % 2] = dn__max(b->width[i % 2], net->conv[branch][i].out);
         b->tile_bytes = dn__max(b->tile_bytes, dn__conv_bytes(net->conv[branch][i].in));
      }
   for (i = 0; i < net->count[DN__DEC]; i++) { /* dec.0's sums lie across from the rows that geo2's last layer reads */
      k = (net->count[DN__GEO2] - 1 + i) % 2;
      b->width[k] = dn__max(b->width[k], i ? net->conv[DN__DEC][i].out : net->slice[0].out);
      if (i) b->tile_bytes = dn__max(b->tile_bytes, dn__conv_bytes(net->conv[DN__DEC][i].in));
   }
   for (i = 0; i < net->slices; i++) b->tile_bytes = dn__max(b->tile_bytes, dn__conv_bytes(net->slice[i].in));
   for (i = 0; i < net->gen_count; i++) widest = dn__max(widest, net->gen[i].out);
   b->middle = (float *)dn__take(a, dn__mul(E, 3), sizeof(float));
   for (k = 0; k < 2; k++) b->rows[k] = (float *)dn__take(a, dn__mul(E, b->width[k]), sizeof(float));
   b->attention = (float *)dn__take(a, dn__mul(E, net->joints), sizeof(float));
   b->piece = (float *)dn__take(a, dn__mul(dn__min(E, DN__EDGE_PIECE), deep), sizeof(float));
   b->sums = (double *)dn__take(a, dn__mul(net->joints, dn__add(deep, 1)), sizeof(double));
   for (k = 0; k < 2; k++) b->joint_rows[k] = (float *)dn__take(a, dn__mul(net->joints, widest), sizeof(float));
   b->slice = (float *)dn__take(a, dn__mul(E, dn__min(deep2, DN__EDGE_SLICE)), sizeof(float));
   b->probed = b->desc->probe ? (float *)dn__take(a, dn__mul(E, deep2), sizeof(float)) : NULL;
   b->tile = (unsigned char *)dn__take(a, b->tile_bytes, dn__workers(b->desc->parallel));
}
static void dn__nbs_layout(dn_blend *o, const dn__nbs_bind *b, dn__arena *a)
{
   dn_blend_view *v = &o->view;
   size_t V = b->vertices, N = b->nodes, S = b->net->joints;
   v->node_of_vertex = (uint32_t *)dn__take(a, V, sizeof(uint32_t));
   v->first_vertex = (uint32_t *)dn__take(a, N, sizeof(uint32_t));
   v->rest = (float *)dn__take(a, dn__mul(N, 3), sizeof(float));
   v->skin_weight = (float *)dn__take(a, dn__mul(N, S), sizeof(float));
   v->joint_offset = (float *)dn__take(a, dn__mul(S, 3), sizeof(float));
   v->joint_rest = (float *)dn__take(a, dn__mul(S, 3), sizeof(float));
   v->shape = (float *)dn__take(a, dn__mul(dn__mul(N, b->net->shapes), 3), sizeof(float));
   v->mask_first = (uint32_t *)dn__take(a, dn__add(N, 1), sizeof(uint32_t));
   v->mask_joint = (uint32_t *)dn__take(a, dn__mul(N, S - 1), sizeof(uint32_t));
   o->rest_vertices = (float *)dn__take(a, dn__mul(V, 3), sizeof(float));
   o->joint = (uint32_t *)dn__take(a, S, sizeof(uint32_t));
}
static double dn__conv_cost(const dn_meshconv *c) { return 5.0 * (double)c->in * (double)c->out; }
static void dn__nbs_cost(dn__nbs_bind *b) /* multiplications; what the steps add up to */
{
   size_t i;
   int branch;
   for (branch = 0; branch < DN__BRANCHES; branch++)
      for (i = branch == DN__DEC; i < b->net->count[branch]; i++) b->all += dn__conv_cost(&b->net->conv[branch][i]);
   for (i = 0; i < b->net->slices; i++) b->all += dn__conv_cost(&b->net->slice[i]);
   b->all *= (double)b->edges;
   if (!(b->all > 0.0)) b->all = 1.0;
}
static dn_result dn__nbs_step(dn__nbs_bind *b, const char *stage, double cost)
{
   const dn_progress *p = b->desc->progress;
   double done;
   b->done += cost;
   done = b->all > 0.0 ? b->done / b->all : 0.0; /* nothing is known before the edges are counted */
   if (p && p->step && p->step(p->user, stage, (float)(done < 1.0 ? done : 1.0)))
      return dn__fail(b->err, DN_CANCELLED, dn__where_blend, SIZE_MAX, "cancelled by the progress callback");
   return DN_OK;
}

/* --- step 1: check, copy, weld, edges */
static dn_result dn__nbs_prepare(dn__nbs_bind *b)
{
   const dn_mesh *m = &b->desc->mesh;
   size_t v, t, c, size = dn__type_size(m->index_type);
   dn_result r = dn__nbs_step(b, "edges", 0.0);
   if (r) return r;
   for (v = 0; v < b->vertices; v++) {
      float *p = b->positions + 3 * v;
      dn__position_at(m, v, p);
      if (!dn__finite(p[0]) || !dn__finite(p[1]) || !dn__finite(p[2]))
         return dn__fail_sizes(b->err, DN_BAD_MESH, dn__where_blend, v, "vertex ", v, NULL, 0,
                               ": its position is not finite");
   }
   b->nodes = dn_weld(b->positions, b->vertices, NULL, NULL, 0, b->desc->weld_distance, b->node_of_vertex,
                      b->first_vertex, NULL, b->work);
   for (v = 0; v < b->nodes; v++)
      memcpy(b->rest + 3 * v, b->positions + 3 * (size_t)b->first_vertex[v], 3 * sizeof(float));
   for (t = 0; t < b->triangles; t++)
      for (c = 0; c < 3; c++) {
         size_t at = dn__index_at(m->indices, m->index_type, (3 * t + c) * size);
         if (at >= b->vertices) {
            char line[160];
            dn__text s = dn__text_of(line, sizeof line);
            dn__put(&s, "triangle ");
            dn__put_size(&s, t);
            dn__put(&s, ": vertex index ");
            dn__put_size(&s, at);
            dn__put(&s, ", expected below ");
            dn__put_size(&s, b->vertices);
            return dn__fail(b->err, DN_BAD_MESH, dn__where_blend, t, line);
         }
         b->triangle[3 * t + c] = b->node_of_vertex[at];
      }
   dn_edges_build(b->rest, b->triangle, b->triangles, b->nodes, b->ends, b->ring, b->first, b->at, NULL, &b->mesh,
                  b->work);
   b->edges = b->mesh.count;
   dn__nbs_cost(b);
   return DN_OK;
}

/* --- step 2: the network */
static const dn_parallel *dn__nbs_parallel(const dn__nbs_bind *b) { return b->desc->probe ? NULL : b->desc->parallel; }
static void dn__nbs_tap(const dn__nbs_bind *b, const char *name, const float *rows, size_t first, size_t count,
                        size_t width)
{
   const dn_probe *p = b->desc->probe;
   if (p && p->tap) p->tap(p->user, name, rows, first, count, width, width);
}
/* edges first .. first + count - 1 of a convolution whose input is packed; y packed too, its row 0 is edge `first` */
static dn__conv_job dn__nbs_job_of(const dn__nbs_bind *b, const dn_meshconv *layer, const float *x, float *y)
{
   dn__conv_job j = dn__conv_of(layer, &b->mesh, x, layer->in, y, layer->out, b->tile);
   j.tile_bytes = b->tile_bytes;
   return j;
}
static void dn__nbs_conv(const dn__nbs_bind *b, const dn_meshconv *layer, const float *x, float *y, size_t first,
                         size_t count)
{
   dn__conv_job j = dn__nbs_job_of(b, layer, x, y);
   j.first = first;
   dn__for(dn__nbs_parallel(b), count, DN__EDGE_TILE, dn__conv_range, &j);
}
/* all layers of a branch but its last, from the midpoints; gives the last one's input */
static dn_result dn__nbs_inner(dn__nbs_bind *b, dn__nbs_branch branch, const char *stage, const float **x)
{
   size_t i, last = b->net->count[branch] - 1;
   *x = b->middle;
   for (i = 0; i < last; i++) {
      const dn_meshconv *c = &b->net->conv[branch][i];
      float *y = b->rows[i % 2];
      char name[DN__NAME];
      dn_result r;
      dn__nbs_conv(b, c, *x, y, 0, b->edges);
      if (branch == DN__ATT) dn_channel_pool(y, c->out, b->edges, c->out, dn__nbs_parallel(b));
      dn__number(name, sizeof name, dn__nbs_branch_names[branch], i, "");
      dn__nbs_tap(b, name, y, 0, b->edges, c->out);
      if ((r = dn__nbs_step(b, stage, dn__conv_cost(c) * (double)b->edges)) != DN_OK) return r;
      *x = y;
   }
   return DN_OK;
}
/* skinning block: edge softmax, then weights by edge -> vertex mean */
static dn_result dn__nbs_weights(dn__nbs_bind *b, float *weight)
{
   const dn_meshconv *last = &b->net->conv[DN__ATT][b->net->count[DN__ATT] - 1];
   size_t i, S = b->net->joints;
   const float *x;
   char name[DN__NAME];
   dn_result r = dn__nbs_inner(b, DN__ATT, "weights", &x);
   if (r) return r;
   dn__nbs_conv(b, last, x, b->attention, 0, b->edges);
   dn__number(name, sizeof name, "att.", b->net->count[DN__ATT] - 1, "");
   dn__nbs_tap(b, name, b->attention, 0, b->edges, S);
   dn_edge_softmax(b->attention, S, b->edges, S, dn__nbs_parallel(b));
   dn__nbs_tap(b, "attention", b->attention, 0, b->edges, S);
   dn_edge_to_vertex(&b->mesh, b->attention, S, S, weight, S, dn__nbs_parallel(b));
   for (i = 0; i < b->nodes; i++)
      if (b->mesh.first[i] == b->mesh.first[i + 1]) weight[i * S] = 1.0f; /* no edge: on joint 0 */
   return dn__nbs_step(b, "weights", dn__conv_cost(last) * (double)b->edges);
}
/* geometry and offset blocks: the rows of geo's last layer go piece by piece into the joints' sums (N 1) */
static dn_result dn__nbs_skeleton(dn__nbs_bind *b, float *offset, float *rest)
{
   const struct dn__blend_net *net = b->net;
   const dn_meshconv *last = &net->conv[DN__GEO][net->count[DN__GEO] - 1];
   size_t S = net->joints, G = last->out, from, n, i, k;
   const float *x;
   float *y = b->joint_rows[0];
   char name[DN__NAME];
   dn_result r = dn__nbs_inner(b, DN__GEO, "skeleton", &x);
   if (r) return r;
   dn__number(name, sizeof name, "geo.", net->count[DN__GEO] - 1, "");
   memset(b->sums, 0, S * (G + 1) * sizeof *b->sums);
   for (from = 0; from < b->edges; from += n) {
      dn__skin_pool_job j;
      n = dn__min(DN__EDGE_PIECE, b->edges - from);
      dn__nbs_conv(b, last, x, b->piece, from, n);
      dn__nbs_tap(b, name, b->piece, from, n, G);
      j.attention = b->attention + from * S;
      j.x = b->piece;
      j.sums = b->sums;
      j.joints = S;
      j.x_stride = j.width = G;
      j.count = n;
      dn__for(dn__nbs_parallel(b), S, 1, dn__skin_pool_add_range, &j);
      if ((r = dn__nbs_step(b, "skeleton", dn__conv_cost(last) * (double)n)) != DN_OK) return r;
   }
   for (i = 0; i < S; i++)
      for (k = 0; k < G; k++) y[i * G + k] = dn__skin_pool_divide(b->sums[i * (G + 1) + k], b->sums[i * (G + 1) + G]);
   dn__nbs_tap(b, "skinning_pool", y, 0, S, G);
   for (i = 0; i < net->gen_count; i++) {
      float *to = i + 1 < net->gen_count ? b->joint_rows[(i + 1) % 2] : offset;
      dn_skeleton_linear_run(&net->gen[i], y, to, dn__nbs_parallel(b));
      dn__number(name, sizeof name, "gen.", i, "");
      dn__nbs_tap(b, name, to, 0, 1, S * net->gen[i].out);
      y = to;
   }
   for (i = 0; i < S; i++)
      for (k = 0; k < 3; k++)
         rest[3 * i + k] = offset[3 * i + k] + (i ? rest[3 * (size_t)net->parents[i] + k] : 0.0f);
   return DN_OK;
}
/* residual branch: a slice of geo2's last channels for all edges, its part of dec.0, the next slice */
static dn_result dn__nbs_shapes(dn__nbs_bind *b, float *shape)
{
   const struct dn__blend_net *net = b->net;
   size_t n2 = net->count[DN__GEO2], E = b->edges, i, from, width;
   const dn_meshconv *last = &net->conv[DN__GEO2][n2 - 1];
   size_t G = last->out, across = (n2 - 1) % 2, e;
   const float *x;
   float *sums = b->rows[across];
   double cost;
   char name[DN__NAME];
   dn_result r = dn__nbs_inner(b, DN__GEO2, "shapes", &x);
   if (r) return r;
   for (i = 0; i < net->slices; i++) {
      const dn_meshconv *part = &net->slice[i];
      const float *rows = b->attention; /* the last slice */
      dn__conv_job j;
      from = i * DN__EDGE_SLICE;
      if (i + 1 < net->slices) {
         width = part->in;
         j = dn__nbs_job_of(b, last, x, b->slice);
         j.column = from;
         j.columns = j.y_stride = width;
         dn__for(dn__nbs_parallel(b), E, DN__EDGE_TILE, dn__conv_range, &j);
         rows = b->slice;
         if (b->probed)
            for (e = 0; e < E; e++) memcpy(b->probed + e * G + from, b->slice + e * width, width * sizeof(float));
      }
      j = dn__nbs_job_of(b, part, rows, sums);
      j.add = i > 0;
      j.activation = i + 1 < net->slices ? DN_ACT_NONE : net->joined;
      dn__for(dn__nbs_parallel(b), E, DN__EDGE_TILE, dn__conv_range, &j);
      cost = dn__conv_cost(part) + (i + 1 < net->slices ? 5.0 * (double)last->in * (double)part->in : 0.0);
      if ((r = dn__nbs_step(b, "shapes", cost * (double)E)) != DN_OK) return r;
   }
   dn__number(name, sizeof name, "geo2.", n2 - 1, "");
   if (b->probed) dn__nbs_tap(b, name, b->probed, 0, E, G);
   x = sums;
   for (i = 0; i < net->count[DN__DEC]; i++) {
      size_t out = i ? net->conv[DN__DEC][i].out : net->slice[0].out;
      if (i) {
         float *y = b->rows[(across + i) % 2];
         dn__nbs_conv(b, &net->conv[DN__DEC][i], x, y, 0, E);
         if ((r = dn__nbs_step(b, "shapes", dn__conv_cost(&net->conv[DN__DEC][i]) * (double)E)) != DN_OK) return r;
         x = y;
      }
      dn__number(name, sizeof name, "dec.", i, "");
      dn__nbs_tap(b, name, x, 0, E, out);
   }
   dn_edge_to_vertex(&b->mesh, x, 3 * net->shapes, 3 * net->shapes, shape, 3 * net->shapes, dn__nbs_parallel(b));
   return DN_OK;
}
/* joint j acts on a node where its own or its parent's weight is above the bar                                    N 5 */
static void dn__nbs_masks(const dn__nbs_bind *b, const float *weight, uint32_t *first, uint32_t *joint)
{
   size_t i, j, S = b->net->joints, n = 0;
   for (i = 0; i < b->nodes; i++) {
      const float *w = weight + i * S;
      first[i] = (uint32_t)n;
      for (j = 1; j < S; j++) {
         double bar = j == 20 || j == 21 ? 0.02 : 0.05; /* the wrists' are lower */
         if ((double)w[j] > bar || (double)w[b->net->parents[j]] > bar) joint[n++] = (uint32_t)j;
      }
   }
   first[b->nodes] = (uint32_t)n;
}
static dn_result dn__nbs_finite(const dn__nbs_bind *b, const float *x, size_t count, size_t width, const char *of,
                                const char *what)
{
   size_t i;
   for (i = 0; i < count * width; i++)
      if (!dn__finite(x[i]))
         return dn__fail_sizes(b->err, DN_BAD_VALUE, dn__where_blend, i / width, of, i / width, NULL, 0, what);
   return DN_OK;
}
/* a prepared mesh through the network, into a blend that has been laid out */
static dn_result dn__nbs_run(dn__nbs_bind *b, dn_blend *o)
{
   dn_blend_view *v = &o->view;
   const struct dn__blend_net *net = b->net;
   size_t i;
   dn_result r;
   o->model = b->model;
   v->vertices = b->vertices;
   v->nodes = b->nodes;
   v->edges = b->edges;
   v->joints = net->joints;
   v->shapes = net->shapes;
   v->seams_welded = b->vertices - b->nodes;
   v->skipped_triangles = b->mesh.skipped;
   v->parents = net->parents;
   v->joint_names = b->model->info.joint_names;
   for (i = 0; i < b->nodes; i++) v->isolated_nodes += b->mesh.first[i] == b->mesh.first[i + 1];
   for (i = 0; i < net->joints; i++) ((uint32_t *)o->joint)[i] = (uint32_t)i;
   memcpy((uint32_t *)v->node_of_vertex, b->node_of_vertex, b->vertices * sizeof(uint32_t));
   memcpy((uint32_t *)v->first_vertex, b->first_vertex, b->nodes * sizeof(uint32_t));
   memcpy((float *)v->rest, b->rest, 3 * b->nodes * sizeof(float));
   memcpy((float *)o->rest_vertices, b->positions, 3 * b->vertices * sizeof(float));
   dn_vertex_to_edge(&b->mesh, b->rest, 3, 3, b->middle, 3, dn__nbs_parallel(b));
   if ((r = dn__nbs_weights(b, (float *)v->skin_weight)) != DN_OK) return r;
   if ((r = dn__nbs_skeleton(b, (float *)v->joint_offset, (float *)v->joint_rest)) != DN_OK) return r;
   if ((r = dn__nbs_shapes(b, (float *)v->shape)) != DN_OK) return r;
   dn__nbs_masks(b, v->skin_weight, (uint32_t *)v->mask_first, (uint32_t *)v->mask_joint);
   if ((r = dn__nbs_finite(b, v->skin_weight, b->nodes, net->joints, "node ",
                           ": its skin weights are not finite")) != DN_OK) return r;
   if ((r = dn__nbs_finite(b, v->joint_rest, net->joints, 3, "joint ", ": its position is not finite")) != DN_OK)
      return r;
   if ((r = dn__nbs_finite(b, v->shape, b->nodes, 3 * net->shapes, "node ",
                           ": its blend shapes are not finite")) != DN_OK) return r;
   if (b->desc->progress && b->desc->progress->step) b->desc->progress->step(b->desc->progress->user, "done", 1.0f); /* too late to cancel */
   return DN_OK;
}

DN_API dn_result dn_blend_size(const dn_model *model, const dn_blend_desc *desc, size_t *bytes, size_t *scratch,
                               dn_error *err)
{
   dn__nbs_bind b;
   dn__arena kept = dn__arena_of(NULL, 0), temp = dn__arena_of(NULL, 0);
   dn_blend measure;
   dn_result r;
   DN_ASSERT(desc && bytes && scratch);
   if ((r = dn__nbs_open(&b, model, desc, err)) != DN_OK) return r;
   dn__take(&kept, 1, sizeof(dn_blend));
   dn__nbs_layout(&measure, &b, &kept);
   dn__nbs_mesh_layout(&b, &temp);
   dn__nbs_net_layout(&b, &temp);
   *bytes = dn__gauge(&kept);
   *scratch = dn__gauge(&temp);
   return *bytes == SIZE_MAX || *scratch == SIZE_MAX ? dn__fail(err, DN_NO_MEMORY, dn__where_blend, SIZE_MAX,
                                                                "sizes overflow") : DN_OK;
}
static dn_result dn__nbs_small(dn_error *err, const char *what, size_t given, size_t needed)
{
   return dn__fail_sizes(err, DN_TOO_SMALL, dn__where_blend, SIZE_MAX, what, given, " bytes given, needed ", needed,
                         NULL);
}
/* a prepared mesh, its network laid out, into memory of at least the right size */
static dn_result dn__nbs_finish(dn__nbs_bind *b, void *memory, size_t bytes, dn_blend **blend)
{
   dn__arena kept = dn__arena_of(memory, bytes);
   dn_blend *o = (dn_blend *)dn__take(&kept, 1, sizeof(dn_blend)), measure;
   dn_result r;
   dn__nbs_layout(&measure, b, &kept);
   if (kept.used > bytes) return dn__nbs_small(b->err, "memory: ", bytes, kept.used);
   memset(o, 0, sizeof *o);
   kept.used = 0;
   dn__take(&kept, 1, sizeof(dn_blend));
   dn__nbs_layout(o, b, &kept);
   o->view.bytes = kept.used;
   if ((r = dn__nbs_run(b, o)) != DN_OK) return r;
   *blend = o;
   return DN_OK;
}
DN_API dn_result dn_blend_init(const dn_model *model, const dn_blend_desc *desc, void *memory, size_t bytes,
                               void *scratch, size_t scratch_bytes, dn_blend **blend, dn_error *err)
{
   dn__nbs_bind b;
   dn__arena temp = dn__arena_of(scratch, scratch_bytes);
   dn_result r;
   DN_ASSERT(desc && memory && scratch && blend && ((uintptr_t)memory & 63) == 0 && ((uintptr_t)scratch & 63) == 0);
   *blend = NULL;
   if ((r = dn__nbs_open(&b, model, desc, err)) != DN_OK) return r;
   dn__nbs_mesh_layout(&b, &temp);
   if (temp.used > scratch_bytes) {
      dn__nbs_net_layout(&b, &temp);
      return dn__nbs_small(err, "scratch: ", scratch_bytes, temp.used);
   }
   if ((r = dn__nbs_prepare(&b)) != DN_OK) return r;
   dn__nbs_net_layout(&b, &temp); /* of the edges that there are */
   if (temp.used > scratch_bytes) return dn__nbs_small(err, "scratch: ", scratch_bytes, temp.used);
   return dn__nbs_finish(&b, memory, bytes, blend);
}
/* Three blocks, so that what depends on the edges is allocated when they have been counted: a closed mesh has half of the
   bound that dn_blend_size must give. */
DN_API dn_blend *dn_blend_create(const dn_model *model, const dn_blend_desc *desc, const dn_allocator *allocator,
                                 dn_error *err)
{
   dn__nbs_bind b;
   dn_blend *blend = NULL, measure;
   void *mesh, *net = NULL, *memory = NULL;
   dn__arena mesh_arena = dn__arena_of(NULL, 0), net_arena = dn__arena_of(NULL, 0), kept = dn__arena_of(NULL, 0);
   size_t mesh_bytes, net_bytes = 0, bytes = 0;
   if (dn__nbs_open(&b, model, desc, err) != DN_OK) return NULL;
   dn__nbs_mesh_layout(&b, &mesh_arena);
   mesh_bytes = mesh_arena.used;
   mesh = dn__alloc(allocator, mesh_bytes);
   if (!mesh) {
      dn__fail_sizes(err, DN_NO_MEMORY, dn__where_blend, SIZE_MAX, "mesh scratch of ", mesh_bytes, NULL, 0, " bytes");
      return NULL;
   }
   mesh_arena = dn__arena_of(mesh, mesh_bytes);
   dn__nbs_mesh_layout(&b, &mesh_arena);
   if (dn__nbs_prepare(&b) == DN_OK) {
      dn__take(&kept, 1, sizeof(dn_blend));
      dn__nbs_layout(&measure, &b, &kept);
      dn__nbs_net_layout(&b, &net_arena);
      bytes = kept.used;
      net_bytes = net_arena.used;
      memory = dn__alloc(allocator, bytes);
      net = memory ? dn__alloc(allocator, net_bytes) : NULL;
      net_arena = dn__arena_of(net, net_bytes);
      if (!net)
         dn__fail_sizes(err, DN_NO_MEMORY, dn__where_blend, SIZE_MAX, "blend of ", bytes, " bytes and scratch of ",
                        net_bytes, " bytes");
      else {
         dn__nbs_net_layout(&b, &net_arena);
         dn__nbs_finish(&b, memory, bytes, &blend);
      }
   }
   dn__release(allocator, net, net_bytes);
   if (!blend) dn__release(allocator, memory, bytes);
   dn__release(allocator, mesh, mesh_bytes);
   if (blend) {
      blend->owned = 1;
      if (allocator) blend->allocator = *allocator, blend->allocator_used = &blend->allocator;
   }
   return blend;
}
DN_API void dn_blend_free(dn_blend *blend)
{
   if (blend && blend->owned) {
      dn_allocator a = blend->allocator; /* the copy inside goes with the memory */
      dn__release(blend->allocator_used ? &a : NULL, blend, blend->view.bytes);
   }
}
DN_API void dn_blend_describe(const dn_blend *blend, dn_blend_view *view) { *view = blend->view; }

/* --- a frame */
typedef struct dn__nbs_frame {
   float *rotations;    /* (S,9) */
   float *transforms;   /* (S,12) */
   float *palette;      /* (S,12) */
   float *coefficients; /* (S-1,B) */
   float *mlp[2];       /* (widest row of coff) */
} dn__nbs_frame;
static dn__nbs_frame dn__nbs_frame_layout(const dn_blend *blend, dn__arena *a)
{
   dn__nbs_frame f;
   size_t S = blend->view.joints;
   const struct dn__blend_net *net = blend->model->blend;
   f.rotations = (float *)dn__take(a, dn__mul(S, 9), sizeof(float));
   f.transforms = (float *)dn__take(a, dn__mul(S, 12), sizeof(float));
   f.palette = (float *)dn__take(a, dn__mul(S, 12), sizeof(float));
   f.coefficients = (float *)dn__take(a, dn__mul(S - 1, net->shapes), sizeof(float));
   f.mlp[0] = (float *)dn__take(a, dn__max(net->coff_width, 9), sizeof(float));
   f.mlp[1] = (float *)dn__take(a, dn__max(net->coff_width, 9), sizeof(float));
   return f;
}
DN_API size_t dn_blend_scratch_size(const dn_blend *blend)
{
   dn__arena a = dn__arena_of(NULL, 0);
   dn__nbs_frame_layout(blend, &a);
   return dn__gauge(&a);
}
DN_API void *dn_blend_scratch_create(const dn_blend *blend, const dn_allocator *allocator, size_t *bytes,
                                     dn_error *err)
{
   void *scratch;
   *bytes = dn_blend_scratch_size(blend);
   scratch = dn__alloc(allocator, *bytes);
   if (!scratch)
      dn__fail_sizes(err, DN_NO_MEMORY, dn__where_blend, SIZE_MAX, "scratch of ", *bytes, NULL, 0, " bytes");
   return scratch;
}
static void dn__nbs_mlps(const dn_blend *blend, const float *rotations, float *coefficients, float *const mlp[2])
{
   const struct dn__blend_net *net = blend->model->blend;
   size_t j, i, k;
   for (j = 0; j + 1 < net->joints; j++) {
      const float *x = mlp[0];
      for (k = 0; k < 9; k++) mlp[0][k] = rotations[9 * (j + 1) + k] - (k % 4 == 0 ? 1.0f : 0.0f); /* R - I */
      for (i = 0; i < net->coff_count; i++) {
         const dn_linear *l = &net->coff[j * net->coff_count + i];
         float *y = i + 1 < net->coff_count ? mlp[(i + 1) % 2] : coefficients + j * net->shapes;
         dn__product(l, x, l->in, y, l->out, 0, 1);
         x = y;
      }
   }
}
DN_API void dn_blend_coefficients(const dn_blend *blend, const float *rotations, float *coefficients, void *scratch)
{
   dn__arena a = dn__arena_of(scratch, SIZE_MAX);
   dn__nbs_frame f = dn__nbs_frame_layout(blend, &a);
   dn__nbs_mlps(blend, rotations, coefficients, f.mlp);
}
/* d = sum_i (sum_j m_j alpha_ij) B_i of node n: few joints act on one node, so their coefficients are added first  N 5 */
static void dn__nbs_offset(const dn_blend *blend, const float *coefficients, size_t n, float d[3])
{
   enum { SHAPES = 16 };
   const dn_blend_view *v = &blend->view;
   size_t B = v->shapes, i, k, from, count;
   double moved[3] = { 0.0, 0.0, 0.0 }; /* joints and shapes of either sign cancel */
   for (from = 0; from < B; from += count) {
      double sum[SHAPES] = { 0.0 };
      const float *shape = v->shape + 3 * (n * B + from);
      count = dn__min(SHAPES, B - from);
      for (k = v->mask_first[n]; k < v->mask_first[n + 1]; k++) {
         const float *row = coefficients + (size_t)(v->mask_joint[k] - 1) * B + from;
         for (i = 0; i < count; i++) sum[i] += (double)row[i];
      }
      for (i = 0; i < count; i++) {
         moved[0] += sum[i] * (double)shape[3 * i];
         moved[1] += sum[i] * (double)shape[3 * i + 1];
         moved[2] += sum[i] * (double)shape[3 * i + 2];
      }
   }
   for (i = 0; i < 3; i++) d[i] = (float)moved[i];
}
typedef struct dn__nbs_job {
   const dn_blend *blend;
   const float *coefficients, *palette;
   float translation[3], strength;
   float *positions, *displacement;
   size_t position_stride, displacement_stride;
} dn__nbs_job;
static void dn__nbs_range(void *job, size_t begin, size_t end, unsigned worker)
{
   const dn__nbs_job *j = (const dn__nbs_job *)job;
   const dn_blend_view *view = &j->blend->view;
   size_t v, S = view->joints;
   int k;
   (void)worker;
   for (v = begin; v < end; v++) {
      size_t n = view->node_of_vertex[v];
      float d[3];
      dn__nbs_offset(j->blend, j->coefficients, n, d);
      for (k = 0; k < 3; k++) d[k] *= j->strength;
      if (j->displacement) memcpy((unsigned char *)j->displacement + v * j->displacement_stride, d, sizeof d);
      if (j->positions) {
         double p[3];
         for (k = 0; k < 3; k++) d[k] += j->blend->rest_vertices[3 * v + (size_t)k];
         dn__lbs_point(j->blend->joint, view->skin_weight + n * S, S, j->palette, d, p); /* N 2, 3 */
         for (k = 0; k < 3; k++) d[k] = (float)(p[k] + (double)j->translation[k]);
         memcpy((unsigned char *)j->positions + v * j->position_stride, d, sizeof d);
      }
   }
}
DN_API void dn_blend_displace(const dn_blend *blend, const float *coefficients, float *displacement, size_t stride,
                              const dn_parallel *parallel)
{
   dn__nbs_job j;
   memset(&j, 0, sizeof j);
   j.blend = blend;
   j.coefficients = coefficients;
   j.strength = 1.0f;
   j.displacement = displacement;
   j.displacement_stride = dn__stride(stride, 12);
   dn__for(parallel, blend->view.vertices, DN__GRAIN, dn__nbs_range, &j);
}
DN_API size_t dn_blend_morph(const dn_blend *blend, size_t joint, size_t shape, float *offsets, size_t stride)
{
   const dn_blend_view *view = &blend->view;
   size_t v, k, moved = 0;
   DN_ASSERT(joint > 0 && joint < view->joints && shape < view->shapes);
   for (v = 0; v < view->vertices; v++) {
      size_t n = view->node_of_vertex[v];
      float d[3] = { 0.0f, 0.0f, 0.0f };
      for (k = view->mask_first[n]; k < view->mask_first[n + 1]; k++)
         if (view->mask_joint[k] == joint) memcpy(d, view->shape + 3 * (n * view->shapes + shape), sizeof d);
      moved += d[0] != 0.0f || d[1] != 0.0f || d[2] != 0.0f;
      if (offsets) memcpy((unsigned char *)offsets + v * dn__stride(stride, 12), d, sizeof d);
   }
   return moved;
}
/* joint s's local rotation: 0 when what was given is not finite, and the identity stands in */
static int dn__nbs_rotation(const dn_blend_input *in, size_t s, float rotation[9])
{
   int k, ok = 1;
   memset(rotation, 0, 9 * sizeof *rotation);
   rotation[0] = rotation[4] = rotation[8] = 1.0f;
   if (in->rotations) {
      for (k = 0; k < 9; k++) ok &= dn__finite(in->rotations[9 * s + (size_t)k]);
      if (ok) memcpy(rotation, in->rotations + 9 * s, 9 * sizeof *rotation);
   } else if (in->axis_angle) {
      for (k = 0; k < 3; k++) ok &= dn__finite(in->axis_angle[3 * s + (size_t)k]);
      if (ok) dn_rodrigues(in->axis_angle + 3 * s, rotation);
   }
   return ok;
}
DN_API dn_result dn_blend_pose(const dn_blend *blend, const dn_blend_input *in, const dn_blend_output *out,
                               void *scratch, size_t scratch_bytes, const dn_parallel *parallel, dn_error *err)
{
   const dn_blend_view *v = &blend->view;
   dn__arena a = dn__arena_of(scratch, scratch_bytes);
   dn__nbs_frame f = dn__nbs_frame_layout(blend, &a);
   dn__nbs_job j;
   size_t s, i, r, S = v->joints, count = (S - 1) * v->shapes, bad = 0;
   DN_ASSERT(in && out && scratch && ((uintptr_t)scratch & 63) == 0);
   if (a.used > scratch_bytes) return dn__nbs_small(err, "scratch: ", scratch_bytes, a.used);
   for (s = 0; s < S; s++) bad += (size_t)!dn__nbs_rotation(in, s, f.rotations + 9 * s);
   if (in->coefficients) memcpy(f.coefficients, in->coefficients, count * sizeof(float));
   else dn__nbs_mlps(blend, f.rotations, f.coefficients, f.mlp);
   for (i = 0; i < count; i++)
      if (!dn__finite(f.coefficients[i])) f.coefficients[i] = 0.0f, bad++;
   dn_forward_kinematics(v->parents, v->joint_offset, f.rotations, S, f.transforms);
   for (s = 0; s < S; s++) /* P_s = T_s times the inverse of a pure translation */
      for (r = 0; r < 3; r++) {
         const float *t = f.transforms + 12 * s + 4 * r, *g = v->joint_rest + 3 * s;
         float *p = f.palette + 12 * s + 4 * r;
         memcpy(p, t, 3 * sizeof *p);
         p[3] = (float)((double)t[3] - ((double)t[0] * (double)g[0] + (double)t[1] * (double)g[1] + (double)t[2] * (double)g[2]));
      }
   memset(&j, 0, sizeof j);
   j.blend = blend;
   j.coefficients = f.coefficients;
   j.palette = f.palette;
   j.strength = !(in->strength > 0.0f) ? 0.0f : in->strength > 1.0f ? 1.0f : in->strength;
   for (i = 0; in->translation && i < 3; i++) {
      j.translation[i] = dn__finite(in->translation[i]) ? in->translation[i] : 0.0f;
      bad += (size_t)!dn__finite(in->translation[i]);
   }
   j.positions = out->positions;
   j.position_stride = dn__stride(out->position_stride, 12);
   j.displacement = out->displacement;
   j.displacement_stride = dn__stride(out->displacement_stride, 12);
   if (out->positions || out->displacement) dn__for(parallel, v->vertices, DN__GRAIN, dn__nbs_range, &j);
   if (out->coefficients) memcpy(out->coefficients, f.coefficients, count * sizeof(float));
   for (s = 0; out->palette && s < S; s++)
      for (r = 0; r < 12; r++)
         out->palette[12 * s + r] = f.palette[12 * s + r] + (r % 4 == 3 ? j.translation[r / 4] : 0.0f);
   return bad ? dn__fail_sizes(err, DN_NOT_FINITE, dn__where_blend, SIZE_MAX, "", bad, NULL, 0,
                               " rotations, coefficients or sides of the translation are not finite") : DN_OK;
}
#ifdef DN_EXACT
   #if defined(__GNUC__) && !defined(__clang__)
      #pragma GCC pop_options
   #endif
   #ifdef DN__NO_SIMD
      #undef DN_NO_SIMD
   #endif
#endif
/* the private macros go: what stays defined is documented in >>config, >>types and >>layers */
#undef DN__AHEAD
#undef DN__ALIGN
#undef DN__ALL
#undef DN__BLOCK
#undef DN__BLOCK_ROWS
#undef DN__BUCKETS
#undef DN__COLUMN
#undef DN__EACH14
#undef DN__EACH3
#undef DN__EACH6
#undef DN__EACH7
#undef DN__EXP2_1
#undef DN__EXP2_2
#undef DN__EXP2_3
#undef DN__EXP2_4
#undef DN__EXP2_LOW
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
#undef DN__F4_RUN
#undef DN__F4_SSE
#undef DN__F4_WASM
#undef DN__FAR
#undef DN__GRAIN
#undef DN__HAS_AVX2
#undef DN__HAS_AVX512
#undef DN__HAS_F4
#undef DN__HAS_VNNI
#undef DN__HEADER_CAP
#undef DN__INLINE
#undef DN__IN_MEMORY
#undef DN__LBS_MANY
#undef DN__LN2_HIGH
#undef DN__LN2_LOW
#undef DN__LOG2E
#undef DN__MOST
#undef DN__NONE
#undef DN__NO_SIMD
#undef DN__OWN_SINE
#undef DN__PROBE_CAP
#undef DN__RANK_CAP
#undef DN__REDUCED_EXP
#undef DN__REDUCED_FLOATS
#undef DN__REDUCED_WEIGHTS
#undef DN__ROUNDED
#undef DN__RUN
#undef DN__RUN_SHORT
#undef DN__SEEDS
#undef DN__SHRINK_A0
#undef DN__SHRINK_A1
#undef DN__SHRINK_B1
#undef DN__SHRINK_B2
#undef DN__SHRINK_MOST
#undef DN__SOON
#undef DN__SOURCE
#undef DN__TANH_0
#undef DN__TANH_1
#undef DN__TANH_2
#undef DN__TANH_3
#undef DN__TANH_4
#undef DN__TANH_SMALL
#undef DN__TARGET_AVX2
#undef DN__TARGET_AVX2_UNFUSED
#undef DN__TARGET_AVX512
#undef DN__TARGET_BF16
#undef DN__TARGET_VNNI
#undef DN__TICK
#undef DN__TILE_ROWS
#undef DN__TOUCH
#undef DN__WEIGHTS
#undef DN__WHOLE

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
