/*  pool_c11.c - pool.c with the threads of the C11 standard
    build   cc -std=c11 -O2 pool_c11.c -o pool_c11 -lpthread */
#define _POSIX_C_SOURCE 200809L
#define POOL_C11
#define EX_POOL_C11
#include "pool.c"
