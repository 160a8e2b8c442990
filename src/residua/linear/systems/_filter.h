/* The inner loop of filters, for the kernels that run them:  x[k+1] = A x[k] + B v[k],  r[k] = C x[k] + D v[k].
 *
 * Every sum is formed in one fixed order (from zero; the columns of v first, then the columns of x), each product
 * rounded before it is added. Vector lanes run over the rows, so the order does not depend on the width of the
 * vectors, the number of plants, or where a recording is cut, and NumPy gives the same bits. This needs a compiler
 * that neither contracts to fused multiply-add nor keeps excess precision: see setup.py for the flags, and the
 * check below.
 *
 * After a sample of nothing but zeros, states below 2^-500 in size become zero, here and in NumPy: a filter at rest
 * would otherwise end among the denormal numbers, which cost processors many times a product. While anything
 * comes in, that costs no more than a look at the first input.
 *
 * A bank is many small filters: blocks of A and C are zero. It is run section by section, and these blocks are left
 * out. No sum is ever -0 (it begins at +0, and 0 + -0 is 0), and zero times a finite number is 0 or -0, so that nothing
 * changes while states are finite. Within a section nothing is left out: a state that is not finite stays so to the end,
 * where it is seen, and the samples are run again with all products. There zero times infinity is NaN in every row.
 */
#ifndef RESIDUA_FILTER_H
#define RESIDUA_FILTER_H

#include <float.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if !defined(FLT_EVAL_METHOD) || FLT_EVAL_METHOD != 0
#error "excess precision would break the bitwise guarantee; residua runs on NumPy here"
#endif
#if defined(__FAST_MATH__)
#error "fast-math would break the bitwise guarantee and the flow of NaN"
#endif
#if defined(_MSC_VER) && !defined(__clang__)
#pragma fp_contract(off)
#endif

#define MAX_SMALL 8 /* largest order and number of outputs that are kept in registers */
#define BLOCK 8     /* rows per block for larger filters */
#define SMALLEST 0x1p-500
#define SPAN 256      /* samples, or plants, that go through the sections of a filter one after the other, at most */
#define AHEAD 256     /* samples from which on signals are asked for while others are run */
#define NEAR_BY 16384 /* numbers of their signals and outputs, which are to stay in the cache; fewer samples cost more */

#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#else
#define INLINE static __forceinline
#endif

/* Samples, one row after the other: the first columns in one array and the others in a second one. */
typedef struct {
    const double *first, *second;
    Py_ssize_t columns, first_step, second_step; /* of the first; numbers from row to row */
} source;

/* States and outputs of a filter that have no product with the others: a member of a bank, or a few. */
typedef struct {
    Py_ssize_t at, n, column, nr; /* the first state and the first output, and how many of them */
    double *packed;
} section;

typedef struct {
    Py_ssize_t n, m, nr, plants, time;
    Py_ssize_t step;           /* numbers from row to row of A and of C, and from plant to plant of x: all states */
    Py_ssize_t r_step, r_room; /* outputs from row to row; of a section how many there are from its own on, else 0 */
    const section *sections;   /* NULL: there is one */
    Py_ssize_t n_sections;
    const double *A, *B, *C, *D, *x;
    source v;
    double *x_next, *r;
    double *packed; /* columns of the matrices, padded with zero rows */
    int is_packed;  /* whether they are there already */
    double *state;  /* room for three states */
    /* Of at most four residuals: four centres and four rows of a whitening, padded with zeros; NULL for none. What
     * comes of it: whitened residuals (room for three more behind them), and sums of their squares. */
    const double *judge;
    double *q, *squares;
    Py_ssize_t k;
} job;

/* Every column of M (rows x columns, its rows so many numbers apart): rows top .. top + width, zero where M has no such
 * row. */
INLINE double *
pack(double *to, const double *M, Py_ssize_t rows, Py_ssize_t columns, Py_ssize_t step, Py_ssize_t top,
     Py_ssize_t width)
{
    for (Py_ssize_t j = 0; j < columns; j++)
        for (Py_ssize_t i = 0; i < width; i++)
            *to++ = top + i < rows ? M[(top + i) * step + j] : 0.0;
    return to;
}

/* ---- blocks of rows: any sizes, plain C ------------------------------------------------------------------------ */

typedef void (*block_product)(const double *columns, const source *v, Py_ssize_t m, const double *x, Py_ssize_t n,
                              double *out, Py_ssize_t rows);

INLINE void
block_product_plain(const double *columns, const source *v, Py_ssize_t m, const double *x, Py_ssize_t n, double *out,
                    Py_ssize_t rows)
{
    double sum[BLOCK] = {0.0};
    for (Py_ssize_t j = 0; j < v->columns; j++, columns += BLOCK)
        for (int i = 0; i < BLOCK; i++)
            sum[i] += columns[i] * v->first[j];
    for (Py_ssize_t j = 0; j < m - v->columns; j++, columns += BLOCK)
        for (int i = 0; i < BLOCK; i++)
            sum[i] += columns[i] * v->second[j];
    for (Py_ssize_t j = 0; j < n; j++, columns += BLOCK)
        for (int i = 0; i < BLOCK; i++)
            sum[i] += columns[i] * x[j];
    for (Py_ssize_t i = 0; i < rows; i++)
        out[i] = sum[i];
}

INLINE double *
pack_blocks(double *to, const double *on_v, Py_ssize_t m, const double *on_x, Py_ssize_t n, Py_ssize_t step,
            Py_ssize_t rows)
{
    for (Py_ssize_t top = 0; top < rows; top += BLOCK) {
        to = pack(to, on_v, rows, m, m, top, BLOCK);
        to = pack(to, on_x, rows, n, step, top, BLOCK);
    }
    return to;
}

INLINE void
all_blocks(block_product product, const double *columns, const source *v, Py_ssize_t m, const double *x, Py_ssize_t n,
           double *out, Py_ssize_t rows)
{
    for (Py_ssize_t top = 0; top < rows; top += BLOCK, columns += BLOCK * (m + n))
        product(columns, v, m, x, n, out + top, rows - top < BLOCK ? rows - top : BLOCK);
}

/* Whether a sample is nothing but zeros; as a rule its first value tells. */
INLINE int
is_silent(const double *first, Py_ssize_t columns, const double *second, Py_ssize_t others)
{
    for (Py_ssize_t j = 0; j < columns; j++)
        if (first[j] != 0.0)
            return 0;
    for (Py_ssize_t j = 0; j < others; j++)
        if (second[j] != 0.0)
            return 0;
    return 1;
}

/* Samples that lie in one array, one row of so many numbers after the other. */
INLINE source
one_array(const double *v, Py_ssize_t m)
{
    return (source){v, v, m, m, 0};
}

INLINE void
flush(double *state, Py_ssize_t n)
{
    for (Py_ssize_t i = 0; i < n; i++)
        state[i] = (state[i] < SMALLEST) & (state[i] > -SMALLEST) & (state[i] != 0.0) ? 0.0 : state[i];
}

INLINE void
run_blocks(const job *q, block_product product)
{
    const Py_ssize_t n = q->n, m = q->m, nr = q->nr;
    double *const on_state = q->packed;
    double *const on_output = on_state + (n + BLOCK - 1) / BLOCK * BLOCK * (m + n);
    if (!q->is_packed) {
        pack_blocks(on_state, q->B, m, q->A, n, q->step, n);
        pack_blocks(on_output, q->D, m, q->C, n, q->step, nr);
    }
    source v = q->v;
    double *r = q->r, *now = q->state, *next = q->state + n;
    for (Py_ssize_t p = 0; p < q->plants; p++) {
        memcpy(now, q->x + p * q->step, (size_t)n * sizeof(double));
        for (Py_ssize_t k = 0; k < q->time; k++, r += q->r_step) {
            all_blocks(product, on_output, &v, m, now, n, r, nr);
            all_blocks(product, on_state, &v, m, now, n, next, n);
            if (is_silent(v.first, v.columns, v.second, m - v.columns))
                flush(next, n);
            double *swap = now;
            now = next;
            next = swap;
            v.first += v.first_step;
            v.second += v.second_step;
        }
        memcpy(q->x_next + p * q->step, now, (size_t)n * sizeof(double));
    }
}

static void
run_plain(const job *q)
{
    run_blocks(q, block_product_plain);
}

/* ---- vectors: blocks as above, and for order and outputs up to 8 the state stays in registers ------------------ */

#if defined(__GNUC__) && !defined(RESIDUA_PLAIN_C)
#define HAVE_VECTORS 1
typedef double lanes2 __attribute__((vector_size(16), aligned(8), may_alias));
typedef double lanes4 __attribute__((vector_size(32), aligned(8), may_alias));
typedef long long flags2 __attribute__((vector_size(16)));
typedef long long flags4 __attribute__((vector_size(32)));
#define SMALL(L, value) ((flags##L)((value) < SMALLEST) & (flags##L)((value) > -SMALLEST) & (flags##L)((value) != 0.0))
typedef void (*runner)(const job *);

/* A padded column is (width / L) vectors of L lanes. Every loop and condition on constants unrolls away. */
#define EACH_VECTOR(width, L) _Pragma("GCC unroll 8") for (int i = 0; i < (width) / (L); i++)
#define ADD_COLUMN(sum, column, width, L, value)                                                                      \
    EACH_VECTOR(width, L) sum[i] += ((const lanes##L *)(column))[i] * (value);

#define DEFINE_BLOCK_PRODUCT(FAMILY, TARGET, L)                                                                       \
    TARGET INLINE void block_product_##FAMILY(const double *columns, const source *v, Py_ssize_t m, const double *x,  \
                                              Py_ssize_t n, double *out, Py_ssize_t rows)                             \
    {                                                                                                                 \
        lanes##L sum[BLOCK / L] = {{0.0}};                                                                            \
        for (Py_ssize_t j = 0; j < v->columns; j++, columns += BLOCK)                                                 \
            ADD_COLUMN(sum, columns, BLOCK, L, v->first[j])                                                           \
        for (Py_ssize_t j = 0; j < m - v->columns; j++, columns += BLOCK)                                             \
            ADD_COLUMN(sum, columns, BLOCK, L, v->second[j])                                                          \
        for (Py_ssize_t j = 0; j < n; j++, columns += BLOCK)                                                          \
            ADD_COLUMN(sum, columns, BLOCK, L, x[j])                                                                  \
        if (rows == BLOCK) {                                                                                          \
            EACH_VECTOR(BLOCK, L)((lanes##L *)out)[i] = sum[i];                                                       \
        } else {                                                                                                      \
            _Pragma("GCC unroll 8") for (int i = 0; i < BLOCK; i++) if (i < rows) out[i] = sum[i / L][i % L];         \
        }                                                                                                             \
    }                                                                                                                 \
    TARGET static void FAMILY##_blocks(const job *q) { run_blocks(q, block_product_##FAMILY); }

/* Numbers further on, which need not be there: processors that guess them by themselves lose nothing. */
#define ASK_FOR(at, further) __builtin_prefetch((const char *)((uintptr_t)(at) + (uintptr_t)(further) * sizeof(double)));

/* JUDGE: whether residuals are also centred and whitened, and their squares added up. A row of residuals is stored
 * with what stands in the lanes behind it, where the next rows come to lie. */
#define DEFINE_SMALL(NAME, TARGET, L, N, WIDTH, OUT, JUDGE)                                                           \
    TARGET static void NAME(const job *q)                                                                             \
    {                                                                                                                 \
        const Py_ssize_t m = q->m, nr = q->nr, columns = q->v.columns, others = m - columns;                          \
        const Py_ssize_t first_step = q->v.first_step, second_step = q->v.second_step;                                \
        double *const a = q->packed;                                                                                  \
        double *const b = a + N * WIDTH, *const c = b + m * WIDTH, *const d = c + N * OUT;                            \
        if (!q->is_packed) {                                                                                          \
            pack(a, q->A, N, N, q->step, 0, WIDTH);                                                                   \
            pack(b, q->B, N, m, m, 0, WIDTH);                                                                         \
            pack(c, q->C, nr, N, q->step, 0, OUT);                                                                    \
            pack(d, q->D, nr, m, m, 0, OUT);                                                                          \
        }                                                                                                             \
        const double *first = q->v.first, *second = q->v.second;                                                      \
        double *restrict r = q->r, *restrict white = q->q, *restrict squares = q->squares;                            \
        const Py_ssize_t step = q->step, r_step = q->r_step, left_step = q->r_room ? 0 : r_step;                      \
        Py_ssize_t left = !q->r_room ? q->plants * q->time * nr : q->r_room >= OUT ? OUT : 0;                         \
        const Py_ssize_t k_white = q->k;                                                                              \
        lanes##L center = {0.0}, whitening[OUT];                                                                      \
        if (JUDGE) {                                                                                                  \
            memcpy(&center, q->judge, sizeof center);                                                                 \
            _Pragma("GCC unroll 8") for (int j = 0; j < OUT; j++)                                                     \
                memcpy(&whitening[j], q->judge + (1 + j) * L, sizeof center);                                         \
        }                                                                                                             \
        for (Py_ssize_t p = 0; p < q->plants; p++) {                                                                  \
            lanes##L x[WIDTH / L];                                                                                    \
            memset(x, 0, sizeof x);                                                                                   \
            if (N % L == 0) {                                                                                         \
                EACH_VECTOR(N, L) x[i] = ((const lanes##L *)(q->x + p * step))[i];                                    \
            } else {                                                                                                  \
                _Pragma("GCC unroll 8") for (int j = 0; j < N; j++) x[j / L][j % L] = q->x[p * step + j];             \
            }                                                                                                         \
            for (Py_ssize_t k = 0; k < q->time; k++, r += r_step, left -= left_step) {                                \
                lanes##L sum[WIDTH / L] = {{0.0}}, out[OUT / L] = {{0.0}};                                            \
                for (Py_ssize_t j = 0; j < columns; j++) {                                                            \
                    ADD_COLUMN(sum, b + j * WIDTH, WIDTH, L, first[j])                                                \
                    ADD_COLUMN(out, d + j * OUT, OUT, L, first[j])                                                    \
                }                                                                                                     \
                for (Py_ssize_t j = 0; j < others; j++) {                                                             \
                    ADD_COLUMN(sum, b + (columns + j) * WIDTH, WIDTH, L, second[j])                                   \
                    ADD_COLUMN(out, d + (columns + j) * OUT, OUT, L, second[j])                                       \
                }                                                                                                     \
                _Pragma("GCC unroll 8") for (int j = 0; j < N; j++)                                                   \
                {                                                                                                     \
                    const double value = x[j / L][j % L];                                                             \
                    ADD_COLUMN(sum, a + j * WIDTH, WIDTH, L, value)                                                   \
                    ADD_COLUMN(out, c + j * OUT, OUT, L, value)                                                       \
                }                                                                                                     \
                EACH_VECTOR(WIDTH, L) x[i] = sum[i];                                                                  \
                if (__builtin_expect(is_silent(first, columns, second, others), 0)) {                                 \
                    double rest[WIDTH];                                                                               \
                    EACH_VECTOR(WIDTH, L)((lanes##L *)rest)[i] = x[i];                                                \
                    flush(rest, WIDTH);                                                                               \
                    __asm__ volatile("" ::: "memory"); /* a branch: as a selection every state would wait for it */   \
                    EACH_VECTOR(WIDTH, L) x[i] = ((lanes##L *)rest)[i];                                               \
                }                                                                                                     \
                ASK_FOR(first, AHEAD * first_step)                                                                    \
                ASK_FOR(second, AHEAD * second_step)                                                                  \
                first += first_step;                                                                                  \
                second += second_step;                                                                                \
                if (JUDGE) {                                                                                          \
                    const lanes##L centred = out[0] - center;                                                         \
                    lanes##L whitened = {0.0};                                                                        \
                    _Pragma("GCC unroll 8") for (int j = 0; j < OUT; j++)                                             \
                        whitened += whitening[j] * centred[j];                                                        \
                    *(lanes##L *)white = whitened;                                                                    \
                    white += k_white;                                                                                 \
                    whitened *= whitened;                                                                             \
                    double total = whitened[0];                                                                       \
                    _Pragma("GCC unroll 8") for (int j = 1; j < OUT; j++) total += whitened[j];                       \
                    *squares++ = total;                                                                               \
                }                                                                                                     \
                if (left >= OUT) {                                                                                    \
                    EACH_VECTOR(OUT, L)((lanes##L *)r)[i] = out[i];                                                   \
                } else {                                                                                              \
                    _Pragma("GCC unroll 8") for (int i = 0; i < OUT; i++) if (i % L == 0 && i + L <= nr)              \
                        ((lanes##L *)r)[i / L] = out[i / L];                                                          \
                    else if (i / L * L + L > nr && i < nr) r[i] = out[i / L][i % L];                                  \
                }                                                                                                     \
            }                                                                                                         \
            if (N % L == 0) {                                                                                         \
                EACH_VECTOR(N, L)((lanes##L *)(q->x_next + p * step))[i] = x[i];                                      \
            } else {                                                                                                  \
                _Pragma("GCC unroll 8") for (int j = 0; j < N; j++) q->x_next[p * step + j] = x[j / L][j % L];        \
            }                                                                                                         \
        }                                                                                                             \
    }

#define DEFINE_ORDER(FAMILY, TARGET, L, N, WIDTH)                                                                     \
    DEFINE_SMALL(FAMILY##_##N##_##L, TARGET, L, N, WIDTH, L, 0)                                                       \
    DEFINE_SMALL(FAMILY##_##N##_8, TARGET, L, N, WIDTH, 8, 0)
#define ROW(FAMILY, L, N) {FAMILY##_##N##_##L, FAMILY##_##N##_8}
#define DEFINE_FAMILY(FAMILY, TARGET, L)                                                                              \
    DEFINE_BLOCK_PRODUCT(FAMILY, TARGET, L)                                                                           \
    DEFINE_ORDER(FAMILY, TARGET, L, 1, L)                                                                             \
    DEFINE_ORDER(FAMILY, TARGET, L, 2, L)                                                                             \
    DEFINE_ORDER(FAMILY, TARGET, L, 3, 4)                                                                             \
    DEFINE_ORDER(FAMILY, TARGET, L, 4, 4)                                                                             \
    DEFINE_ORDER(FAMILY, TARGET, L, 5, 8)                                                                             \
    DEFINE_ORDER(FAMILY, TARGET, L, 6, 8)                                                                             \
    DEFINE_ORDER(FAMILY, TARGET, L, 7, 8)                                                                             \
    DEFINE_ORDER(FAMILY, TARGET, L, 8, 8)                                                                             \
    static const runner FAMILY##_table[MAX_SMALL][2] = {ROW(FAMILY, L, 1), ROW(FAMILY, L, 2), ROW(FAMILY, L, 3),      \
                                                        ROW(FAMILY, L, 4), ROW(FAMILY, L, 5), ROW(FAMILY, L, 6),      \
                                                        ROW(FAMILY, L, 7), ROW(FAMILY, L, 8)};                        \
    static void FAMILY##_filter(const job *q)                                                                         \
    {                                                                                                                 \
        if (q->n >= 1 && q->n <= MAX_SMALL && q->nr <= MAX_SMALL)                                                     \
            FAMILY##_table[q->n - 1][q->nr > L](q);                                                                   \
        else                                                                                                          \
            FAMILY##_blocks(q);                                                                                       \
    }

DEFINE_FAMILY(baseline, , 2)
#if defined(__x86_64__)
#define HAVE_AVX2 1
#define AVX2 __attribute__((target("avx2"))) /* this target does not bring FMA with it */
DEFINE_FAMILY(avx2, AVX2, 4)
#if defined(RESIDUA_JUDGES)
#define DEFINE_EIGHT(NAME, JUDGE)                                                                                     \
    DEFINE_SMALL(NAME##_1, AVX2, 4, 1, 4, 4, JUDGE)                                                                   \
    DEFINE_SMALL(NAME##_2, AVX2, 4, 2, 4, 4, JUDGE)                                                                   \
    DEFINE_SMALL(NAME##_3, AVX2, 4, 3, 4, 4, JUDGE)                                                                   \
    DEFINE_SMALL(NAME##_4, AVX2, 4, 4, 4, 4, JUDGE)                                                                   \
    DEFINE_SMALL(NAME##_5, AVX2, 4, 5, 8, 4, JUDGE)                                                                   \
    DEFINE_SMALL(NAME##_6, AVX2, 4, 6, 8, 4, JUDGE)                                                                   \
    DEFINE_SMALL(NAME##_7, AVX2, 4, 7, 8, 4, JUDGE)                                                                   \
    DEFINE_SMALL(NAME##_8, AVX2, 4, 8, 8, 4, JUDGE)                                                                   \
    static const runner NAME##_table[MAX_SMALL] = {NAME##_1, NAME##_2, NAME##_3, NAME##_4,                            \
                                                   NAME##_5, NAME##_6, NAME##_7, NAME##_8};

DEFINE_EIGHT(judged, 1)

#define EACH_OF(count, k) _Pragma("GCC unroll 4") for (int k = 0; k < (count); k++)
#define ADD_TO_EACH(P, WIDTH, on_state, on_output, value)                                                             \
    EACH_OF(P, k)                                                                                                     \
    {                                                                                                                 \
        const double one = (value);                                                                                   \
        ADD_COLUMN(sum[k], on_state, WIDTH, 4, one)                                                                   \
        ADD_COLUMN(out[k], on_output, 4, 4, one)                                                                      \
    }

/* The same of one sample of many plants, P of them side by side: their sums do not wait for one another, and loops end
 * less often. The last plants are run one by one, since rows are stored with what stands in the lanes behind them. */
#define DEFINE_TICK(NAME, ALONE, N, WIDTH, P)                                                                         \
    AVX2 static void NAME(const job *q)                                                                               \
    {                                                                                                                 \
        const Py_ssize_t m = q->m, nr = q->nr, columns = q->v.columns, others = m - columns, step = q->step;          \
        const Py_ssize_t first_step = q->v.first_step, second_step = q->v.second_step, k_white = q->k;                \
        const double *const a = q->packed, *const b = a + N * WIDTH, *const c = b + m * WIDTH, *const d = c + N * 4;  \
        lanes4 center, whitening[4];                                                                                  \
        memcpy(&center, q->judge, sizeof center);                                                                     \
        memcpy(whitening, q->judge + 4, sizeof whitening);                                                            \
        job rest = *q;                                                                                                \
        for (; rest.plants > P; rest.plants -= P) {                                                                   \
            const double *const first = rest.v.first, *const second = rest.v.second, *const x = rest.x;               \
            lanes4 sum[P][WIDTH / 4] = {{{0.0}}}, out[P][1] = {{{0.0}}};                                              \
            for (Py_ssize_t j = 0; j < columns; j++)                                                                  \
                ADD_TO_EACH(P, WIDTH, b + j * WIDTH, d + j * 4, first[k * first_step + j])                            \
            for (Py_ssize_t j = 0; j < others; j++)                                                                   \
                ADD_TO_EACH(P, WIDTH, b + (columns + j) * WIDTH, d + (columns + j) * 4, second[k * second_step + j])  \
            _Pragma("GCC unroll 8") for (int j = 0; j < N; j++)                                                       \
                ADD_TO_EACH(P, WIDTH, a + j * WIDTH, c + j * 4, x[k * step + j])                                      \
            EACH_OF(P, k)                                                                                             \
            {                                                                                                         \
                double state[WIDTH];                                                                                  \
                EACH_VECTOR(WIDTH, 4)((lanes4 *)state)[i] = sum[k][i];                                                \
                if (__builtin_expect(is_silent(first + k * first_step, columns, second + k * second_step, others), 0))\
                    flush(state, WIDTH);                                                                              \
                memcpy(rest.x_next + k * step, state, N * sizeof(double));                                            \
                const lanes4 centred = out[k][0] - center;                                                            \
                lanes4 whitened = {0.0};                                                                              \
                _Pragma("GCC unroll 4") for (int j = 0; j < 4; j++) whitened += whitening[j] * centred[j];            \
                *(lanes4 *)(rest.q + k * k_white) = whitened;                                                         \
                whitened *= whitened;                                                                                 \
                rest.squares[k] = ((whitened[0] + whitened[1]) + whitened[2]) + whitened[3];                          \
                *(lanes4 *)(rest.r + k * nr) = out[k][0];                                                             \
            }                                                                                                         \
            rest.v.first += P * first_step;                                                                           \
            rest.v.second += P * second_step;                                                                         \
            rest.x += P * step;                                                                                       \
            rest.x_next += P * step;                                                                                  \
            rest.r += P * nr;                                                                                         \
            rest.q += P * k_white;                                                                                    \
            rest.squares += P;                                                                                        \
        }                                                                                                             \
        ALONE(&rest);                                                                                                 \
    }
DEFINE_TICK(tick_1, judged_1, 1, 4, 4)
DEFINE_TICK(tick_2, judged_2, 2, 4, 4)
DEFINE_TICK(tick_3, judged_3, 3, 4, 4)
DEFINE_TICK(tick_4, judged_4, 4, 4, 4)
DEFINE_TICK(tick_5, judged_5, 5, 8, 2)
DEFINE_TICK(tick_6, judged_6, 6, 8, 2)
DEFINE_TICK(tick_7, judged_7, 7, 8, 2)
DEFINE_TICK(tick_8, judged_8, 8, 8, 2)
static const runner tick_table[MAX_SMALL] = {tick_1, tick_2, tick_3, tick_4, tick_5, tick_6, tick_7, tick_8};
#endif

#endif
#endif

/* Numbers that the packed matrices of a filter take, at most, and up to the next line of the cache. */
INLINE Py_ssize_t
packed_size(Py_ssize_t n, Py_ssize_t m, Py_ssize_t nr)
{
    return ((n + nr + 2 * BLOCK) * (n + m) + 7) / 8 * 8;
}

/* ---- sections --------------------------------------------------------------------------------------------------- */

/* About how many vectors of four numbers a sample costs. */
INLINE Py_ssize_t
cost_of(Py_ssize_t n, Py_ssize_t m, Py_ssize_t nr)
{
    if (n <= MAX_SMALL && nr <= MAX_SMALL)
        return (n + m) * ((n > 4 ? 2 : 1) + (nr > 4 ? 2 : 1)) + 8;
    return (n + m) * 2 * ((n + BLOCK - 1) / BLOCK + (nr + BLOCK - 1) / BLOCK) + 16;
}

/* Where the states can be cut: from which of them on a section can begin, and with which output. */
static Py_ssize_t
find_cuts(const job *q, Py_ssize_t *furthest, section *cuts)
{
    const Py_ssize_t n = q->n, nr = q->nr;
    Py_ssize_t count = 0, reached = 0;
    for (Py_ssize_t i = 0; i < n; i++)
        furthest[i] = i;
    for (Py_ssize_t i = 0; i < n; i++)
        for (Py_ssize_t j = 0; j < n; j++)
            if (q->A[i * n + j] != 0.0) {
                const Py_ssize_t low = i < j ? i : j, high = i < j ? j : i;
                furthest[low] = furthest[low] > high ? furthest[low] : high;
            }
    Py_ssize_t *const first = furthest + n, *const last = first + nr; /* state of each output; n and -1 of none */
    for (Py_ssize_t i = 0; i < nr; i++) {
        first[i] = n;
        last[i] = -1;
        for (Py_ssize_t j = 0; j < n; j++)
            if (q->C[i * n + j] != 0.0) {
                first[i] = first[i] < j ? first[i] : j;
                last[i] = j;
            }
    }
    for (Py_ssize_t at = 0; at < n; at++) {
        Py_ssize_t column = 0;
        int is_cut = at == 0 || reached < at;
        for (Py_ssize_t i = 0; i < nr; i++)
            column = last[i] >= 0 && last[i] < at ? i + 1 : column;
        for (Py_ssize_t i = 0; i < nr; i++)
            is_cut &= i < column ? last[i] < at : first[i] >= at;
        reached = furthest[at] > reached ? furthest[at] : reached;
        if (is_cut)
            cuts[count++] = (section){.at = at, .column = column};
    }
    return count;
}

/* The sections of a filter, of which small ones side by side are one where that costs less; NULL if there is one, or no
 * memory. The caller frees them. Room for their packed matrices, in numbers, is added to `size`. */
static section *
find_sections(const job *q, Py_ssize_t *n_sections, Py_ssize_t *size)
{
    const Py_ssize_t n = q->n, m = q->m, nr = q->nr;
    *n_sections = 0;
    if (n < 2 || (n <= MAX_SMALL && nr <= MAX_SMALL))
        return NULL;
    section *const cuts = malloc((size_t)n * sizeof(section));
    Py_ssize_t *const room = malloc((size_t)(3 * n + 2 * nr + 2) * sizeof(Py_ssize_t));
    const Py_ssize_t count = cuts == NULL || room == NULL ? 0 : find_cuts(q, room, cuts);
    Py_ssize_t *const least = room, *const next = room + n + 1; /* from each cut on: the least cost, and the next cut */
    for (Py_ssize_t i = count - 1; i >= 0 && count > 1; i--) {
        least[count] = 0;
        least[i] = PY_SSIZE_T_MAX;
        for (Py_ssize_t j = i + 1; j <= count; j++) {
            const Py_ssize_t states = (j < count ? cuts[j].at : n) - cuts[i].at;
            const Py_ssize_t cost = cost_of(states, m, (j < count ? cuts[j].column : nr) - cuts[i].column) + least[j];
            if (cost < least[i]) {
                least[i] = cost;
                next[i] = j;
            }
        }
    }
    for (Py_ssize_t i = 0; i < count && count > 1; i = next[i]) {
        const Py_ssize_t j = next[i];
        section *const one = &cuts[(*n_sections)++]; /* never beyond i */
        *one = cuts[i];
        one->n = (j < count ? cuts[j].at : n) - one->at;
        one->nr = (j < count ? cuts[j].column : nr) - one->column;
        *size += packed_size(one->n, m, one->nr);
    }
    free(room);
    if (*n_sections > 1)
        return cuts;
    *n_sections = 0;
    free(cuts);
    return NULL;
}

/* Give the sections their room. */
static void
place_sections(section *sections, Py_ssize_t count, Py_ssize_t m, double *room)
{
    for (Py_ssize_t j = 0; j < count; j++) {
        sections[j].packed = room;
        room += packed_size(sections[j].n, m, sections[j].nr);
    }
}

/* ---- choice of path ------------------------------------------------------------------------------------------- */

enum { PATH_PLAIN = 0, PATH_BASELINE = 1, PATH_AVX2 = 2 };

/* What a filter is that has one section and a place of its own in memory. */
INLINE void
as_a_whole(job *q)
{
    q->step = q->n;
    q->r_step = q->nr;
    q->r_room = 0;
    q->sections = NULL;
    q->n_sections = 0;
}

/* Where numbers that begin with a line of the cache can be put, in room for seven more. */
INLINE double *
line_of(double *room)
{
    return (double *)(((uintptr_t)room + 63) & ~(uintptr_t)63);
}

static int
best_path(void)
{
#if defined(HAVE_AVX2)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx2"))
        return PATH_AVX2;
#endif
#if defined(HAVE_VECTORS)
    return PATH_BASELINE;
#else
    return PATH_PLAIN;
#endif
}

static int execute(const job *q, int path);

/* A section of a filter from some plant and sample on, its states in x. */
INLINE job
job_of(const job *q, const section *s, double *x)
{
    job one = *q;
    one.n = s->n;
    one.nr = s->nr;
    one.sections = NULL;
    one.A = q->A + s->at * (q->step + 1);
    one.B = q->B + s->at * q->m;
    one.C = q->C + s->column * q->step + s->at;
    one.D = q->D + s->column * q->m;
    one.x = q->x + s->at;
    one.x_next = x + s->at;
    one.packed = s->packed;
    one.r = q->r + s->column;
    one.r_room = q->nr - s->column;
    one.judge = NULL;
    return one;
}

static void
pack_sections(const job *q, int path)
{
    for (Py_ssize_t j = 0; j < q->n_sections; j++) {
        job one = job_of(q, &q->sections[j], NULL);
        one.plants = 0;
        one.is_packed = 0;
        execute(&one, path);
    }
}

/* Some samples of a plant, or one of several plants, whose packed sections are there: one section after the other. A
 * row of outputs is stored with what stands behind it, which the next section overwrites. */
static void
run_each(const job *q, int path)
{
    for (Py_ssize_t j = 0; j < q->n_sections; j++) {
        job one = job_of(q, &q->sections[j], q->x_next);
        one.is_packed = 1;
        execute(&one, path);
    }
}

INLINE int
are_finite(const double *values, Py_ssize_t count)
{
    double sum = 0.0; /* 0 times a finite number is 0 */
    for (Py_ssize_t j = 0; j < count; j++)
        sum += 0.0 * values[j];
    return sum == 0.0;
}

/* Run a filter section by section, and again as a whole where a state has not stayed finite. */
static void
run_sections(const job *q, int path)
{
    const int is_tick = q->time == 1 && q->plants > 1 && q->x != q->x_next;
    const Py_ssize_t near_by = NEAR_BY / (q->m + q->nr + 1), span = near_by < 16 ? 16 : near_by < SPAN ? near_by : SPAN;
    double *const x = q->state + 2 * q->n;
    job whole = *q, some = *q;
    whole.sections = NULL;
    for (Py_ssize_t p = 0; p < q->plants; p += whole.plants) {
        const Py_ssize_t room = q->plants - p;
        whole.plants = is_tick ? (room < span ? room : span) : 1;
        whole.x = q->x + p * q->n;
        whole.x_next = q->x_next + p * q->n;
        whole.v.first = q->v.first + p * q->time * q->v.first_step;
        whole.v.second = q->v.second + p * q->time * q->v.second_step;
        whole.r = q->r + p * q->time * q->nr;
        some.v = whole.v;
        some.r = whole.r;
        if (is_tick) {
            some.plants = whole.plants;
            some.x = whole.x;
            some.x_next = whole.x_next;
            run_each(&some, path);
        } else {
            some.plants = 1;
            some.x = some.x_next = x;
            memcpy(x, whole.x, (size_t)q->n * sizeof(double));
            for (Py_ssize_t k = 0; k < q->time; k += span) {
                some.time = q->time - k < span ? q->time - k : span;
                run_each(&some, path);
                some.v.first += some.time * some.v.first_step;
                some.v.second += some.time * some.v.second_step;
                some.r += some.time * q->nr;
            }
        }
        if (!are_finite(some.x_next, whole.plants * q->n))
            execute(&whole, path);
        else if (!is_tick)
            memcpy(whole.x_next, x, (size_t)q->n * sizeof(double));
    }
}

/* Run a filter; whether residuals were judged too. */
static int
execute(const job *q, int path)
{
    if (q->sections != NULL) {
        run_sections(q, path);
        return 0;
    }
#if defined(HAVE_AVX2)
    if (path == PATH_AVX2) {
#if defined(RESIDUA_JUDGES)
        if (q->judge != NULL && q->n >= 1 && q->n <= MAX_SMALL) {
            if (q->time == 1 && q->plants > 1 && q->is_packed)
                tick_table[q->n - 1](q);
            else
                judged_table[q->n - 1](q);
            return 1;
        }
#endif
        avx2_filter(q);
        return 0;
    }
#endif
#if defined(HAVE_VECTORS)
    if (path == PATH_BASELINE) {
        baseline_filter(q);
        return 0;
    }
#endif
    (void)path;
    run_plain(q);
    return 0;
}

#endif
