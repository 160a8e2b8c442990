/* The filter of a plant with at most eight states and four residuals, four samples after the other, whose residuals are
 * judged together: they lie in columns, so that vectors run over the samples. The same sums as in _filter.h, and as
 * `squares_of_rows` has them. While the states of one sample wait for those of the one before, that costs little.
 */
#ifndef RESIDUA_FOUR_SAMPLES_H
#define RESIDUA_FOUR_SAMPLES_H

#if defined(HAVE_AVX2)

/* What is judged, of as many whitened residuals as residuals, and what comes of it. */
typedef struct {
    lanes4 center[4], whitening[4][4]; /* each number four times: of a residual, and of a whitened one */
    double limit;      /* of squares */
    int whitens;       /* whether residuals are judged at all */
    double *squares;   /* of each sample */
    double *columns;   /* of each whitened residual, so many numbers apart; NULL for none */
    double *rows;      /* the same in rows; NULL for none */
    Py_ssize_t apart;
    double sizes;      /* the sum of the sizes of all residuals, or more */
    int is_within;     /* whether no square is over the limit */
    double values;     /* the sum of the sizes of all signals, where they lie one sample after the other */
} quads;

typedef long long flags4u __attribute__((vector_size(32), aligned(8), may_alias));

/* Numbers of two vectors, those of the second counted from four on. */
#if defined(__clang__)
#define CHOSEN(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define CHOSEN(a, b, ...) __builtin_shuffle(a, b, (flags4){__VA_ARGS__})
#endif
#define COLUMN_OF(a, b, c, d) CHOSEN(a, b, c, d, 4 + (c), 4 + (d))

/* Four samples of NR residuals each, in rows. */
#define DEFINE_JUDGED_QUAD(NR)                                                                                        \
    AVX2 INLINE void judge_quad_##NR(const lanes4 *rows, quads *to, Py_ssize_t k, lanes4 *sizes, flags4 *within)      \
    {                                                                                                                 \
        const flags4 sign = (flags4){0} + INT64_MAX;                                                                  \
        const lanes4 even = CHOSEN(rows[0], rows[1], 0, 4, 2, 6);                                                     \
        const lanes4 odd = CHOSEN(rows[0], rows[1], 1, 5, 3, 7);                                                      \
        const lanes4 even_too = CHOSEN(rows[2], rows[3], 0, 4, 2, 6);                                                 \
        const lanes4 odd_too = CHOSEN(rows[2], rows[3], 1, 5, 3, 7);                                                  \
        const lanes4 column[4] = {COLUMN_OF(even, even_too, 0, 1), COLUMN_OF(odd, odd_too, 0, 1),                     \
                                  COLUMN_OF(even, even_too, 2, 3), COLUMN_OF(odd, odd_too, 2, 3)};                    \
        lanes4 centred[NR], total = {0.0};                                                                            \
        _Pragma("GCC unroll 4") for (int j = 0; j < NR; j++)                                                          \
        {                                                                                                             \
            *sizes += (lanes4)((flags4)column[j] & sign);                                                             \
            centred[j] = column[j] - to->center[j];                                                                   \
        }                                                                                                             \
        lanes4 white[4] = {{0.0}};                                                                                    \
        _Pragma("GCC unroll 4") for (int l = 0; l < NR; l++)                                                          \
        {                                                                                                             \
            lanes4 sum = centred[0] * to->whitening[0][l]; /* from zero it would be 0 where this is -0 */             \
            _Pragma("GCC unroll 4") for (int j = 1; j < NR; j++) sum += centred[j] * to->whitening[j][l];             \
            total += sum * sum;                                                                                       \
            white[l] = sum + 0.0;                                                                                     \
            if (to->columns != NULL)                                                                                  \
                *(lanes4 *)(to->columns + l * to->apart + k) = white[l];                                              \
        }                                                                                                             \
        if (to->rows != NULL) {                                                                                       \
            double *const at = to->rows + k * NR;                                                                     \
            const lanes4 low = CHOSEN(white[0], white[1], 0, 4, 2, 6);                                                \
            const lanes4 high = CHOSEN(white[0], white[1], 1, 5, 3, 7);                                               \
            const lanes4 low_too = CHOSEN(white[2], white[3], 0, 4, 2, 6);                                            \
            const lanes4 high_too = CHOSEN(white[2], white[3], 1, 5, 3, 7);                                           \
            *(lanes4 *)at = COLUMN_OF(low, low_too, 0, 1);                                                            \
            *(lanes4 *)(at + NR) = COLUMN_OF(high, high_too, 0, 1);                                                   \
            *(lanes4 *)(at + 2 * NR) = COLUMN_OF(low, low_too, 2, 3);                                                 \
            *(lanes4 *)(at + 3 * NR) = COLUMN_OF(high, high_too, 2, 3);                                               \
        }                                                                                                             \
        *(lanes4 *)(to->squares + k) = total;                                                                         \
        *within &= (flags4)(total <= to->limit);                                                                      \
    }
DEFINE_JUDGED_QUAD(1)
DEFINE_JUDGED_QUAD(2)
DEFINE_JUDGED_QUAD(3)
DEFINE_JUDGED_QUAD(4)

/* As many samples as there are four and four, of one plant; how many. Rows of residuals are stored as four numbers,
 * however few they have: the last few samples are left. */
#define DEFINE_QUADS(NAME, N, WIDTH)                                                                                  \
    AVX2 static Py_ssize_t NAME(const job *q, quads *to)                                                              \
    {                                                                                                                 \
        const Py_ssize_t m = q->m, nr = q->nr, columns = q->v.columns, others = m - columns;                          \
        const Py_ssize_t first_step = q->v.first_step, second_step = q->v.second_step;                                \
        const double *const a = q->packed, *const b = a + N * WIDTH, *const c = b + m * WIDTH, *const d = c + N * 4;  \
        const double *first = q->v.first, *second = q->v.second;                                                      \
        double *restrict r = q->r;                                                                                    \
        lanes4 x[WIDTH / 4], sizes = {0.0}, values = {0.0};                                                                 \
        flags4 within = ((flags4){0} == (flags4){0});                                                                 \
        const flags4 sign = (flags4){0} + INT64_MAX;                                                                  \
        Py_ssize_t k = 0;                                                                                             \
        memset(x, 0, sizeof x);                                                                                       \
        if (N % 4 == 0) {                                                                                             \
            EACH_VECTOR(N, 4) x[i] = ((const lanes4 *)q->x)[i];                                                       \
        } else {                                                                                                      \
            _Pragma("GCC unroll 8") for (int j = 0; j < N; j++) x[j / 4][j % 4] = q->x[j];                            \
        }                                                                                                             \
        for (; k + 7 <= q->time; k += 4) {                                                                            \
            lanes4 rows[4];                                                                                           \
            for (Py_ssize_t j = 0; j < columns; j++) {                                                                \
                values += (lanes4)(((const flags4u *)first)[j] & sign);                                               \
                ASK_FOR(first, AHEAD * first_step + 4 * j)                                                            \
            }                                                                                                         \
            for (Py_ssize_t j = 0; j < others; j++) {                                                                 \
                values += (lanes4)(((const flags4u *)second)[j] & sign);                                              \
                ASK_FOR(second, AHEAD * second_step + 4 * j)                                                          \
            }                                                                                                         \
            _Pragma("GCC unroll 4") for (int p = 0; p < 4; p++)                                                       \
            {                                                                                                         \
                lanes4 sum[WIDTH / 4] = {{0.0}}, out[1] = {{0.0}};                                                    \
                for (Py_ssize_t j = 0; j < columns; j++) {                                                            \
                    ADD_COLUMN(sum, b + j * WIDTH, WIDTH, 4, first[j])                                                \
                    ADD_COLUMN(out, d + j * 4, 4, 4, first[j])                                                        \
                }                                                                                                     \
                for (Py_ssize_t j = 0; j < others; j++) {                                                             \
                    ADD_COLUMN(sum, b + (columns + j) * WIDTH, WIDTH, 4, second[j])                                   \
                    ADD_COLUMN(out, d + (columns + j) * 4, 4, 4, second[j])                                           \
                }                                                                                                     \
                _Pragma("GCC unroll 8") for (int j = 0; j < N; j++)                                                   \
                {                                                                                                     \
                    const double value = x[j / 4][j % 4];                                                             \
                    ADD_COLUMN(sum, a + j * WIDTH, WIDTH, 4, value)                                                   \
                    ADD_COLUMN(out, c + j * 4, 4, 4, value)                                                           \
                }                                                                                                     \
                EACH_VECTOR(WIDTH, 4) x[i] = sum[i];                                                                  \
                if (__builtin_expect(is_silent(first, columns, second, others), 0)) {                                 \
                    double rest[WIDTH];                                                                               \
                    EACH_VECTOR(WIDTH, 4)((lanes4 *)rest)[i] = x[i];                                                  \
                    flush(rest, WIDTH);                                                                               \
                    __asm__ volatile("" ::: "memory"); /* as in _filter.h */                                          \
                    EACH_VECTOR(WIDTH, 4) x[i] = ((lanes4 *)rest)[i];                                                 \
                }                                                                                                     \
                first += first_step;                                                                                  \
                second += second_step;                                                                                \
                rows[p] = out[0];                                                                                     \
                *(lanes4 *)r = out[0];                                                                                \
                r += nr;                                                                                              \
            }                                                                                                         \
            if (!to->whitens) {                                                                                       \
                _Pragma("GCC unroll 4") for (int p = 0; p < 4; p++) sizes += (lanes4)((flags4)rows[p] & sign);        \
            } else if (nr == 3)                                                                                       \
                judge_quad_3(rows, to, k, &sizes, &within);                                                           \
            else if (nr == 2)                                                                                         \
                judge_quad_2(rows, to, k, &sizes, &within);                                                           \
            else if (nr == 1)                                                                                         \
                judge_quad_1(rows, to, k, &sizes, &within);                                                           \
            else                                                                                                      \
                judge_quad_4(rows, to, k, &sizes, &within);                                                           \
        }                                                                                                             \
        if (N % 4 == 0) {                                                                                             \
            EACH_VECTOR(N, 4)((lanes4 *)q->x_next)[i] = x[i];                                                         \
        } else {                                                                                                      \
            _Pragma("GCC unroll 8") for (int j = 0; j < N; j++) q->x_next[j] = x[j / 4][j % 4];                       \
        }                                                                                                             \
        to->sizes = (sizes[0] + sizes[1]) + (sizes[2] + sizes[3]);                                                    \
        to->values = (values[0] + values[1]) + (values[2] + values[3]);                                               \
        to->is_within = within[0] && within[1] && within[2] && within[3];                                             \
        return k;                                                                                                     \
    }
DEFINE_QUADS(quads_1, 1, 4)
DEFINE_QUADS(quads_2, 2, 4)
DEFINE_QUADS(quads_3, 3, 4)
DEFINE_QUADS(quads_4, 4, 4)
DEFINE_QUADS(quads_5, 5, 8)
DEFINE_QUADS(quads_6, 6, 8)
DEFINE_QUADS(quads_7, 7, 8)
DEFINE_QUADS(quads_8, 8, 8)

/* All samples of one plant; whether residuals are sound. The last ones, up to six, go through the usual filter. */
static int
run_quads(const job *q, quads *to)
{
    static Py_ssize_t (*const table[MAX_SMALL])(const job *, quads *) = {quads_1, quads_2, quads_3, quads_4,
                                                                         quads_5, quads_6, quads_7, quads_8};
    const Py_ssize_t k = table[q->n - 1](q, to), left = q->time - k, nr = q->nr;
    job rest = *q;
    double rows[6 * 4 + 4];
    rest.time = left;
    rest.x = q->x_next;
    rest.v.first += k * q->v.first_step;
    rest.v.second += k * q->v.second_step;
    rest.r += k * nr;
    rest.q = rows;
    rest.squares = to->squares + k;
    judged_table[q->n - 1](&rest);
    for (Py_ssize_t i = 0; i < left; i++) {
        to->is_within &= rest.squares[i] <= to->limit;
        for (Py_ssize_t j = 0; j < rest.v.columns; j++)
            to->values += fabs(rest.v.first[i * rest.v.first_step + j]);
        for (Py_ssize_t j = 0; j < rest.m - rest.v.columns; j++)
            to->values += fabs(rest.v.second[i * rest.v.second_step + j]);
        for (Py_ssize_t j = 0; j < nr; j++) {
            to->sizes += fabs(rest.r[i * nr + j]);
            if (to->columns != NULL)
                to->columns[j * to->apart + k + i] = rows[i * nr + j];
            if (to->rows != NULL)
                to->rows[(k + i) * nr + j] = rows[i * nr + j];
        }
    }
    return to->sizes <= LARGEST;
}

#endif
#endif
