/* What kernels of environments stand on. Behind OD_HOST the text is C++, and a kernel a loop over environments. */
#ifdef OD_HOST
#include <math.h>
#include <stdint.h>
#include <string.h>
#define __device__
#define __forceinline__ inline
#define __noinline__ __attribute__((noinline))
static inline uint32_t __float_as_uint(float x) { uint32_t bits; memcpy(&bits, &x, 4); return bits; }
static inline float __uint_as_float(uint32_t bits) { float x; memcpy(&x, &bits, 4); return x; }
static inline float __fmaf_rn(float a, float b, float c) { return __builtin_fmaf(a, b, c); }
static inline float __fsqrt_rn(float x) { return __builtin_sqrtf(x); }
static inline uint64_t od_bits(double x) { uint64_t bits; memcpy(&bits, &x, 8); return bits; }
static inline double od_number(uint64_t bits) { double x; memcpy(&x, &bits, 8); return x; }
static inline double od_root(double x) { return __builtin_sqrt(x); }
static inline uint64_t od_high(uint64_t a, uint64_t b) { return (uint64_t)(((unsigned __int128)a * b) >> 64); }
#define OD_KERNEL(name, of, count, blocks) \
    static void name##_one(const of &e, uint32_t i); \
    extern "C" void name(const of *e) { for (uint32_t i = 0; i < (count)(*e); i++) name##_one(*e, i); } \
    static void name##_one(const of &e, uint32_t i)
#else
typedef unsigned char uint8_t;
typedef int int32_t;
typedef unsigned int uint32_t;
typedef long long int64_t;
typedef unsigned long long uint64_t;
#define NAN __uint_as_float(0x7FFFFFFFu)
#define INFINITY __uint_as_float(0x7F800000u)
static __device__ __forceinline__ uint64_t od_bits(double x) { return (uint64_t)__double_as_longlong(x); }
static __device__ __forceinline__ double od_number(uint64_t bits) { return __longlong_as_double((int64_t)bits); }
static __device__ __forceinline__ double od_root(double x) { return __dsqrt_rn(x); }
static __device__ __forceinline__ uint64_t od_high(uint64_t a, uint64_t b) { return __umul64hi(a, b); }
#define OD_KERNEL(name, of, count, blocks) \
    static __device__ __forceinline__ void name##_one(const of &e, uint32_t i); \
    extern "C" __global__ void __launch_bounds__(128, blocks) name(const of e) \
    { \
        const uint32_t i = blockIdx.x * blockDim.x + threadIdx.x; \
        if (i < (count)(e)) name##_one(e, i); \
    } \
    static __device__ __forceinline__ void name##_one(const of &e, uint32_t i)
#endif
#define od_own static __device__

/* arrays of rows, one number of all environments each; then those of single numbers */
typedef struct {
    float *plant, *kept, *work, *shared, *model;
    uint64_t *seed, *episode;
    const float *action;
    float *info, *final_observation, *final_central;
    uint8_t *terminated, *truncated, *due, *restart, *seen;
    double *sums;
    const double *mean;
    float *tape; /* of one step */
    uint8_t *tape_running, *tape_ended, *tape_moved, *moved;
    int64_t action_environment, action_number;
    uint64_t first_environment;
    double difficulty;
    uint32_t n, stride, collects, clears, stops, unused;
} od_env;

od_own uint32_t od_environments(const od_env &e) { return e.n; }

/* rows of the caller, nothing where there are none */
typedef struct {
    const float *at;
    int64_t environment, number;
} od_given;

od_own float od_of(const od_given &given, uint32_t i, uint32_t k)
{
    return given.at ? given.at[(int64_t)i * given.environment + (int64_t)k * given.number] : 0.0f;
}

/* a step that is pulled */
typedef struct {
    const float *tape, *statistics;
    float *carried, *action, *parameters, *seeds, *results;
    const uint8_t *running, *ended, *moved; /* moved: behind the step, nothing for the last one */
    uint64_t *dropped;
    od_given observation, final_observation, central, final_central, final_carried, reward, loss;
    float decay, clip;
    uint32_t n, stride;
} od_sweep;

od_own uint32_t od_pulled(const od_sweep &e) { return e.n; }
