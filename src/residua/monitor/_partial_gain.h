/* The gain of a Kalman filter for a sample of which some values are missing, as residua.monitor.partial_update has it.
 *
 * The same sums in the same order as there, so that the bits are the same. Gains are remembered by what they follow
 * from: the covariance of the prediction and which values are there. Plants that miss the same values need the same ones.
 */
#ifndef RESIDUA_PARTIAL_GAIN_H
#define RESIDUA_PARTIAL_GAIN_H

#define MOST_GAINS 1024         /* that are remembered in one run: a power of two */
#define ROOM_FOR_GAINS 4194304  /* bytes; larger filters remember fewer */

/* Matrices of the plant and its noise, and what is derived from them, as in PartialUpdate.numbers. */
typedef struct {
    Py_ssize_t n, inputs, p; /* states, inputs and outputs of the plant */
    const double *A, *B, *C, *D, *K, *Q, *R, *S, *covariance, *free_input, *most, *reached, *unknown, *root;
} partial_plan;

typedef struct {
    uint64_t hash;
    int is_there, is_stationary, is_lost, is_apart;
    flag *pattern;                 /* of all channels: the inputs that are known, the outputs that can be used */
    double *before, *after;        /* covariances of the prediction, zero for the stationary one */
    double *A, *B, *C, *D, *packed; /* of the filter with this gain */
} gain;

typedef struct {
    gain *gains;
    Py_ssize_t slots, bytes; /* how many, and of each */
    double *work;            /* room for what is computed on the way */
    flag *pattern;
    char *room;
} gain_store;

INLINE Py_ssize_t
partial_numbers(Py_ssize_t n, Py_ssize_t inputs, Py_ssize_t p)
{
    return 5 * n * n + n * inputs + 3 * p * n + p * inputs + 2 * p * p + inputs + n;
}

INLINE void
point_at_partial(partial_plan *q, const double *at)
{
    const Py_ssize_t n = q->n, p = q->p, inputs = q->inputs;
    const double **const places[] = {&q->A, &q->B, &q->C, &q->D, &q->K, &q->Q, &q->R, &q->S, &q->covariance,
                                     &q->free_input, &q->most, &q->reached, &q->unknown, &q->root};
    const Py_ssize_t sizes[] = {n * n, n * inputs, p * n, p * inputs, n * p, n * n, p * p, n * p, n * n,
                                inputs, n, n * n, n * n, p * p};
    for (size_t j = 0; j < sizeof sizes / sizeof *sizes; at += sizes[j++])
        *places[j] = at;
}

/* out = X M, or X times the transpose of M; every sum from zero and in order. */
INLINE void
product(const double *X, const double *M, double *restrict out, Py_ssize_t rows, Py_ssize_t inner, Py_ssize_t columns,
        int is_transposed)
{
    for (Py_ssize_t i = 0; i < rows; i++)
        for (Py_ssize_t j = 0; j < columns; j++) {
            double sum = 0.0;
            for (Py_ssize_t k = 0; k < inner; k++)
                sum += X[i * inner + k] * (is_transposed ? M[j * inner + k] : M[k * columns + j]);
            out[i * columns + j] = sum;
        }
}

/* The lower triangular root of a positive definite matrix, in its place. */
static void
root_of(double *M, Py_ssize_t size)
{
    for (Py_ssize_t j = 0; j < size; j++) {
        for (Py_ssize_t k = 0; k < j; k++)
            for (Py_ssize_t i = j; i < size; i++)
                M[i * size + j] -= M[i * size + k] * M[j * size + k];
        const double pivot = sqrt(M[j * size + j]);
        for (Py_ssize_t i = j; i < size; i++)
            M[i * size + j] /= pivot;
    }
}

/* The inverse of a lower triangular matrix. */
static void
inverse_of(const double *L, double *out, Py_ssize_t size)
{
    for (Py_ssize_t i = 0; i < size; i++) {
        for (Py_ssize_t j = 0; j < size; j++)
            out[i * size + j] = i == j ? 1.0 : 0.0;
        for (Py_ssize_t k = 0; k < i; k++)
            for (Py_ssize_t j = 0; j < size; j++)
                out[i * size + j] -= L[i * size + k] * out[k * size + j];
        for (Py_ssize_t j = 0; j < size; j++)
            out[i * size + j] /= L[i * size + i];
    }
}

/* Rows and columns of the outputs that are there; how many. */
INLINE Py_ssize_t
outputs_there(const partial_plan *q, const flag *there, double *C, double *R, double *S)
{
    const Py_ssize_t n = q->n, p = q->p;
    Py_ssize_t count = 0, at = 0;
    for (Py_ssize_t i = 0; i < p; i++)
        count += there[i];
    for (Py_ssize_t i = 0; i < p; i++) {
        if (!there[i])
            continue;
        memcpy(C + at * n, q->C + i * n, (size_t)n * sizeof(double));
        for (Py_ssize_t j = 0, k = 0; j < p; j++)
            if (there[j])
                R[at * count + k++] = q->R[i * p + j];
        for (Py_ssize_t j = 0; j < n; j++)
            S[j * count + at] = q->S[j * p + i];
        at++;
    }
    return count;
}

/* Numbers of room that `solve_gain` takes. */
INLINE Py_ssize_t
work_of_gain(const partial_plan *q)
{
    const Py_ssize_t widest = q->n > q->p ? q->n : q->p, inputs = q->inputs;
    return 14 * widest * widest + 2 * q->n * inputs + q->p * inputs;
}

/* K of all outputs and of those that are there, and the inverse of the root of the covariance of these. */
static void
solve_gain(const partial_plan *q, const double *P, const flag *there, int is_stationary, Py_ssize_t count,
           const double *C, const double *R, const double *S, double *K, double *K_there, double *inverse, double *work)
{
    const Py_ssize_t n = q->n, p = q->p, square = (n > p ? n : p) * (n > p ? n : p);
    double *const first = work, *const second = work + square, *const cross = second + square;
    product(C, P, first, count, n, n, 0);
    product(first, C, second, count, n, count, 1);
    for (Py_ssize_t i = 0; i < count * count; i++)
        second[i] += R[i];
    root_of(second, count);
    inverse_of(second, inverse, count);
    if (is_stationary) {
        memcpy(K, q->K, (size_t)(n * p) * sizeof(double));
        memcpy(K_there, q->K, (size_t)(n * p) * sizeof(double));
        return;
    }
    product(q->A, P, first, n, n, n, 0);
    product(first, C, cross, n, n, count, 1);
    for (Py_ssize_t i = 0; i < n * count; i++)
        cross[i] += S[i];
    product(cross, inverse, first, n, count, count, 1);
    product(first, inverse, K_there, n, count, count, 0);
    for (Py_ssize_t i = 0; i < n; i++)
        for (Py_ssize_t j = 0, k = 0; j < p; j++)
            K[i * p + j] = there[j] ? K_there[i * count + k++] : 0.0;
}

/* The covariance of the next prediction by the form of Joseph, in `out`. */
static void
follow_covariance(const partial_plan *q, const double *P, const gain *g, const double *K, const double *R,
                  const double *S, Py_ssize_t count, double *out, double *work)
{
    const Py_ssize_t n = q->n, inputs = q->inputs, square = (n > q->p ? n : q->p) * (n > q->p ? n : q->p);
    double *const carried = work, *const other = work + square, *const noise = other + square;
    double *const held = noise + square, *const weighted = held + n * inputs;
    product(K, S, carried, n, count, n, 1);
    product(K, R, other, n, count, count, 0);
    product(other, K, noise, n, count, n, 1);
    for (Py_ssize_t i = 0; i < n; i++)
        for (Py_ssize_t j = 0; j < n; j++)
            noise[i * n + j] = q->Q[i * n + j] - carried[i * n + j] - carried[j * n + i] + noise[i * n + j];
    product(g->A, P, other, n, n, n, 0);
    product(other, g->A, carried, n, n, n, 1);
    for (Py_ssize_t i = 0; i < n * n; i++)
        carried[i] += noise[i];
    Py_ssize_t missing = 0, at = 0;
    for (Py_ssize_t j = 0; j < inputs; j++)
        missing += !g->pattern[j];
    for (Py_ssize_t j = 0; j < inputs; j++) {
        if (g->pattern[j])
            continue;
        for (Py_ssize_t i = 0; i < n; i++) {
            held[i * missing + at] = q->B[i * inputs + j];
            weighted[i * missing + at] = q->B[i * inputs + j] * q->free_input[j];
        }
        at++;
    }
    if (missing) {
        product(weighted, held, other, n, missing, n, 1);
        for (Py_ssize_t i = 0; i < n * n; i++)
            carried[i] += other[i];
    }
    for (Py_ssize_t i = 0; i < n; i++)
        for (Py_ssize_t j = 0; j < n; j++)
            out[i * n + j] = (carried[i * n + j] + carried[j * n + i]) / 2;
}

/* The matrices of the filter with gain K: from inputs and outputs to innovations, in units of the stationary ones where
 * all outputs are there. */
static void
filter_of_gain(const partial_plan *q, gain *g, const double *K, const double *inverse, int is_whole, double *work)
{
    const Py_ssize_t n = q->n, p = q->p, inputs = q->inputs, m = inputs + p;
    const Py_ssize_t square = (n > p ? n : p) * (n > p ? n : p);
    double *const units = work, *const part = work + square, *const by_input = part + square;
    product(K, q->C, part, n, p, n, 0);
    for (Py_ssize_t i = 0; i < n * n; i++)
        g->A[i] = q->A[i] - part[i];
    product(K, q->D, by_input, n, p, inputs, 0);
    for (Py_ssize_t i = 0; i < n; i++) {
        for (Py_ssize_t j = 0; j < inputs; j++)
            g->B[i * m + j] = q->B[i * inputs + j] - by_input[i * inputs + j];
        memcpy(g->B + i * m + inputs, K + i * p, (size_t)p * sizeof(double));
    }
    if (is_whole)
        product(q->root, inverse, units, p, p, p, 0);
    else
        for (Py_ssize_t i = 0; i < p * p; i++)
            units[i] = i % (p + 1) ? 0.0 : 1.0;
    product(units, q->C, g->C, p, p, n, 0);
    for (Py_ssize_t i = 0; i < p * n; i++)
        g->C[i] = -g->C[i];
    product(units, q->D, by_input, p, p, inputs, 0);
    for (Py_ssize_t i = 0; i < p; i++) {
        for (Py_ssize_t j = 0; j < inputs; j++)
            g->D[i * m + j] = -by_input[i * inputs + j];
        memcpy(g->D + i * m + inputs, units + i * p, (size_t)p * sizeof(double));
    }
}

/* Fill in a gain whose covariance before and pattern are there. */
static void
make_gain(const partial_plan *q, gain *g, double *work)
{
    const Py_ssize_t n = q->n, p = q->p, square = (n > p ? n : p) * (n > p ? n : p);
    const flag *const there = g->pattern + q->inputs;
    int is_steady = 1, all_outputs = 1, all = 1, is_reached = 1, is_lost = 0;
    for (Py_ssize_t i = 0; i < n * n; i++)
        is_steady &= g->before[i] == 0.0;
    for (Py_ssize_t j = 0; j < p; j++)
        all_outputs &= there[j];
    for (Py_ssize_t j = 0; j < q->inputs + p; j++)
        all &= g->pattern[j];
    const double *const P = is_steady ? q->covariance : g->before;
    const int is_stationary = is_steady && all;
    g->is_stationary = is_stationary;
    double *const C = work, *const R = C + square, *const S = R + square, *const K = S + square;
    double *const K_there = K + square, *const inverse = K_there + square, *const rest = inverse + square;
    const Py_ssize_t count = outputs_there(q, there, C, R, S);
    solve_gain(q, P, there, is_stationary, count, C, R, S, K, K_there, inverse, rest);
    filter_of_gain(q, g, K, inverse, all_outputs && !is_stationary, rest);
    follow_covariance(q, P, g, K_there, R, S, count, g->after, rest);
    for (Py_ssize_t i = 0; i < n * n; i++)
        is_reached &= fabs(g->after[i] - q->covariance[i]) <= q->reached[i];
    for (Py_ssize_t i = 0; i < n; i++)
        is_lost |= !(g->after[i * n + i] <= q->most[i]);
    g->is_lost = is_lost;
    if (is_reached || is_stationary)
        memset(g->after, 0, (size_t)(n * n) * sizeof(double));
    g->is_apart = 0;
    for (Py_ssize_t i = 0; i < n * n; i++)
        g->is_apart |= g->after[i] != 0.0;
}

/* ---- those that are remembered ----------------------------------------------------------------------------------- */

/* Room for gains, which takes memory as they come; 0 without memory. */
static int
make_gain_store(gain_store *store, const partial_plan *q)
{
    const Py_ssize_t n = q->n, m = q->inputs + q->p;
    const Py_ssize_t numbers = 2 * n * n + (n + q->p) * (n + m) + packed_size(n, m, q->p) + 8;
    store->bytes = (Py_ssize_t)sizeof(double) * (numbers + (m + 7) / 8);
    for (store->slots = MOST_GAINS; store->slots > 1 && store->slots * store->bytes > ROOM_FOR_GAINS;)
        store->slots /= 2;
    store->gains = calloc((size_t)store->slots, sizeof(gain));
    store->room = malloc((size_t)(store->slots * store->bytes));
    store->work = malloc((size_t)work_of_gain(q) * sizeof(double) + (size_t)m);
    if (store->gains == NULL || store->room == NULL || store->work == NULL)
        return 0;
    store->pattern = (flag *)(store->work + work_of_gain(q));
    return 1;
}

static void
free_gain_store(gain_store *store)
{
    free(store->gains);
    free(store->room);
    free(store->work);
    memset(store, 0, sizeof *store); /* it may be let go twice */
}

INLINE uint64_t
hash_of(const double *values, Py_ssize_t count, const flag *pattern, Py_ssize_t m)
{
    uint64_t hash = 0x9E3779B97F4A7C15u;
    for (Py_ssize_t i = 0; i < count; i++) {
        uint64_t bits;
        memcpy(&bits, values + i, sizeof bits);
        hash = (hash ^ bits) * 0xFF51AFD7ED558CCDu;
        hash ^= hash >> 32;
    }
    for (Py_ssize_t j = 0; j < m; j++)
        hash = (hash ^ pattern[j]) * 0x100000001B3u;
    return hash ^ hash >> 29;
}

/* Where the numbers of a slot lie. */
static void
place_gain(gain *g, const partial_plan *q, char *room)
{
    const Py_ssize_t n = q->n, p = q->p, m = q->inputs + p;
    g->packed = line_of((double *)room);
    g->before = g->packed + packed_size(n, m, p);
    g->after = g->before + n * n;
    g->A = g->after + n * n;
    g->B = g->A + n * n;
    g->C = g->B + n * m;
    g->D = g->C + p * n;
    g->pattern = (flag *)(g->D + p * m);
}

/* The gain for a sample with the pattern of the store, by the covariance of its prediction; `filter` packs matrices. */
static const gain *
find_gain(gain_store *store, const partial_plan *q, const double *covariance, const job *filter, int path)
{
    const Py_ssize_t n = q->n, m = q->inputs + q->p;
    const uint64_t hash = hash_of(covariance, n * n, store->pattern, m);
    const Py_ssize_t slot = (Py_ssize_t)(hash & (uint64_t)(store->slots - 1));
    gain *const g = store->gains + slot;
    if (g->is_there && g->hash == hash && memcmp(g->before, covariance, (size_t)(n * n) * sizeof(double)) == 0
        && memcmp(g->pattern, store->pattern, (size_t)m) == 0)
        return g;
    place_gain(g, q, store->room + slot * store->bytes);
    g->hash = hash;
    g->is_there = 1;
    memcpy(g->before, covariance, (size_t)(n * n) * sizeof(double));
    memcpy(g->pattern, store->pattern, (size_t)m);
    make_gain(q, g, store->work);
    job one = *filter;
    as_a_whole(&one);
    one.A = g->A;
    one.B = g->B;
    one.C = g->C;
    one.D = g->D;
    one.packed = g->packed;
    one.is_packed = 0;
    one.plants = 0;
    one.judge = NULL;
    execute(&one, path);
    return g;
}

#endif
