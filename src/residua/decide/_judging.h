/* Tests and isolations of the fused loop: the same sums in the same order as their NumPy code.
 *
 * Each takes a piece of one plant, and its own row of the state. To bring a test of another kind here, write its
 * statistic, a line in `judge_stream`, and `compiled` in its Python file.
 */
#ifndef RESIDUA_JUDGING_H
#define RESIDUA_JUDGING_H

#include <math.h>
#if defined(HAVE_AVX2)
#include <immintrin.h>
#endif

/* Whether a number is a constant of at most four: loops over so many unroll, and what they keep stays in registers. */
#if defined(__GNUC__)
#define FEW(k) (__builtin_constant_p(k) && (k) <= 4)
#else
#define FEW(k) ((k) <= 4)
#endif
#define UNROLLED _Pragma("GCC unroll 4") /* a loop over so few, within one over samples */

#define LARGEST_WHITENED 1e120 /* as in residua.decide.whitened_norm */
#define LARGEST_SQUARES 9e239  /* sums of squares up to here are of numbers up to there */
#define FULL 2.0               /* as in residua.decide.cusum */

enum { NORM = 1, PAGE, CROSIER, PIGNATIELLO_RUNGER, EWMA, CHI_SQUARED, GLR, DIRECTED_GLR, PARTS, MEANS };
enum { NOBODY, DIRECTIONS, CODES };

typedef unsigned char flag;
typedef long long whole;

/* A test with every number filled in; k whitened residuals of nr. */
typedef struct {
    int kind;
    Py_ssize_t nr, k, window, order, knots_of_each, sums, directions;
    whole persistence, release;
    double root; /* of the window */
    double threshold, release_level, allowance, old_weight, new_weight, deviation;
    double padded[20]; /* of at most four residuals: centres, then rows of the whitening, and zeros */
    const double *center, *whitening, *coefficients, *rewhitening, *knots, *scores, *along;
    /* Of parts: their first columns, and the end; their thresholds; of each column the residuals that it takes, and with
     * which weights, `terms` rows; and a whitening of all, or NULL. */
    Py_ssize_t parts, terms;
    const whole *begins, *from;
    const double *limits, *weights, *joint;
    /* Of a bank of means: how many there are, their weights, what scales each, and of each part the lengths at which a
     * sample is clipped, a mean is full, and an alarm ends. */
    Py_ssize_t scales;
    const double *mean_weights, *scaling, *clips, *fulls, *releases;
} test_plan;

typedef struct {
    int kind;
    Py_ssize_t k, window, groups; /* k: residuals, or members; a window of 0: clear means */
    double clear;                 /* the square of the length of such a mean */
    const flag *codes; /* of each group, which members it fires */
    double share;
    int is_at_once; /* a member that is in alarm counts as fired, whatever the window */
    const whole *dimensions;
    const double *padded; /* k rows of all columns of all groups, and zeros */
    Py_ssize_t columns, room; /* of a row: a multiple of four numbers */
    int are_lines; /* every signature has one column */
} isolation_plan;

typedef struct {
    double *values, *begun;
    whole *filled;
} window_row;

typedef struct {
    window_row window;
    double *past, *sums;
    flag *past_usable;
    whole *up, *down;
    flag *alarm;
} test_row;

/* What is known of the samples of a piece; of `usable` first where the filter has settled, then where all is known. */
typedef struct {
    Py_ssize_t time;
    const double *r;
    double *q, *sums, *statistic, *scores;
    double *e, *history; /* room: of a piece, what the past does not foretell; and of sums over the last samples */
    flag *usable, *over, *alarm;
    whole *up;
    int is_judged; /* q is there already, and the squares of its rows in `statistic` */
    int is_within; /* and none of them is too large, nor over the threshold of a norm without a window */
    Py_ssize_t apart; /* numbers from one column of q to the next, where it lies in columns; else 0 */
    double *rows;     /* room for q in rows */
    int is_put;       /* whether q, which is in columns, is in rows where it is to be left */
    int is_laned;  /* whether a long piece may be judged part by part */
    int is_raw;    /* q is not there: residuals are whitened where they are read, and none becomes too large */
    int is_quiet;  /* nothing is over, and nothing was: `over`, `alarm` and `up` are not written then */
} piece;

INLINE double
square_of(const double *v, Py_ssize_t k)
{
    double total = 0.0;
    for (Py_ssize_t j = 0; j < k; j++)
        total += v[j] * v[j];
    return total;
}

INLINE double
length_of(const double *v, Py_ssize_t k)
{
    return sqrt(square_of(v, k));
}

/* out = v @ M, every sum from zero and in order. */
INLINE void
row_product(const double *restrict v, const double *restrict M, Py_ssize_t rows, Py_ssize_t columns,
            double *restrict out)
{
    for (Py_ssize_t j = 0; j < columns; j++)
        out[j] = 0.0;
    for (Py_ssize_t i = 0; i < rows; i++)
        for (Py_ssize_t j = 0; j < columns; j++)
            out[j] += v[i] * M[i * columns + j];
}

INLINE int
all_within(const double *v, Py_ssize_t count, double largest)
{
    if (count >= 16) { /* no value is larger than the sum of their sizes, which is NaN if one is */
        double sizes[16] = {0.0}, sum = 0.0;
        Py_ssize_t j = 0;
        for (; j + 16 <= count; j += 16)
            for (int l = 0; l < 16; l++)
                sizes[l] += fabs(v[j + l]);
        for (; j < count; j++)
            sum += fabs(v[j]);
        for (int l = 0; l < 16; l++)
            sum += sizes[l];
        if (sum <= largest)
            return 1;
    }
    double outside[8] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0}; /* lanes of vectors */
    Py_ssize_t i = 0;
    for (; i + 8 <= count; i += 8)
        for (int l = 0; l < 8; l++)
            outside[l] = (v[i + l] <= largest) & (v[i + l] >= -largest) ? outside[l] : 1.0;
    for (; i < count; i++)
        outside[0] = (v[i] <= largest) & (v[i] >= -largest) ? outside[0] : 1.0;
    double any = 0.0;
    for (int l = 0; l < 8; l++)
        any += outside[l];
    return any == 0.0;
}

INLINE int
all_set(const flag *flags, Py_ssize_t count)
{
    return count == 1 ? flags[0] : memchr(flags, 0, (size_t)count) == NULL;
}

INLINE void
whitened_of(const test_plan *t, const double *r, double *q, Py_ssize_t nr, Py_ssize_t k)
{
    if (FEW(nr) && FEW(k)) { /* of rows that are padded with zeros */
        double sum[4] = {0.0, 0.0, 0.0, 0.0};
        UNROLLED for (Py_ssize_t i = 0; i < nr; i++) {
            const double centred = r[i] - t->padded[i];
            UNROLLED for (int j = 0; j < 4; j++)
                sum[j] += centred * t->padded[4 + 4 * i + j];
        }
        UNROLLED for (Py_ssize_t j = 0; j < k; j++)
            q[j] = sum[j];
        return;
    }
    for (Py_ssize_t j = 0; j < k; j++)
        q[j] = 0.0;
    for (Py_ssize_t i = 0; i < nr; i++)
        for (Py_ssize_t j = 0; j < k; j++)
            q[j] += (r[i] - t->center[i]) * t->whitening[i * k + j];
}

/* Square roots of sums of squares. */
INLINE void
roots(double *values, Py_ssize_t count)
{
    for (Py_ssize_t i = 0; i < count; i++)
        values[i] = sqrt(values[i]);
}

INLINE double
largest_of(const double *values, Py_ssize_t count)
{
    double largest[8] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0}; /* lanes of vectors */
    Py_ssize_t i = 0;
    for (; i + 8 <= count; i += 8)
        for (int l = 0; l < 8; l++)
            largest[l] = values[i + l] > largest[l] ? values[i + l] : largest[l];
    for (; i < count; i++)
        largest[0] = values[i] > largest[0] ? values[i] : largest[0];
    for (int l = 1; l < 8; l++)
        largest[0] = largest[l] > largest[0] ? largest[l] : largest[0];
    return largest[0];
}

/* Sums of squares of whitened residuals alone, of numbers of residuals that are constants: vectors over samples. 0, and
 * nothing to be read of them, where one may not be usable. */
INLINE int
squares_of_rows(const test_plan *t, const piece *p, Py_ssize_t nr, Py_ssize_t k)
{
    double center[4], weight[4][4];
    if (!FEW(nr) || !FEW(k) || !all_set(p->usable, p->time))
        return 0;
    for (Py_ssize_t j = 0; j < nr; j++) {
        center[j] = t->center[j];
        for (Py_ssize_t l = 0; l < k; l++)
            weight[j][l] = t->whitening[j * k + l];
    }
    const double *restrict r = p->r;
    double *restrict squares = p->statistic;
    for (Py_ssize_t i = 0; i < p->time; i++) {
        double total = 0.0;
        for (Py_ssize_t l = 0; l < k; l++) {
            double sum = 0.0;
            for (Py_ssize_t j = 0; j < nr; j++)
                sum += (r[i * nr + j] - center[j]) * weight[j][l];
            total += sum * sum;
        }
        squares[i] = total;
    }
    return all_within(squares, p->time, LARGEST_SQUARES);
}

/* Whitened residuals; 0 and not usable where one would overflow a sum. Whether their squares are in `statistic`. */
INLINE int
whiten(const test_plan *t, const piece *p, Py_ssize_t nr, Py_ssize_t k)
{
    if (all_set(p->usable, p->time)) {
        if (p->is_judged && (p->is_within || all_within(p->statistic, p->time, LARGEST_SQUARES)))
            return 1;
        for (Py_ssize_t i = 0; i < p->time; i++)
            whitened_of(t, p->r + i * nr, p->q + i * k, nr, k);
        if (all_within(p->q, p->time * k, LARGEST_WHITENED))
            return 0;
    }
    for (Py_ssize_t i = 0; i < p->time; i++) {
        double *q = p->q + i * k;
        if (p->usable[i])
            whitened_of(t, p->r + i * nr, q, nr, k);
        if (p->usable[i] && all_within(q, k, LARGEST_WHITENED))
            continue;
        p->usable[i] = 0;
        for (Py_ssize_t j = 0; j < k; j++)
            q[j] = 0.0;
    }
    return 0;
}

/* Cut the time where a block of the window is full: what is kept becomes sums of the samples after each place. */
INLINE void
turn_window(window_row row, Py_ssize_t window, Py_ssize_t k)
{
    *row.filled = 0;
    for (Py_ssize_t j = 0; j < k; j++)
        row.begun[j] = 0.0;
    if (FEW(k)) {
        double sum[4] = {0.0, 0.0, 0.0, 0.0};
        for (Py_ssize_t i = window - 1; i >= 0; i--)
            UNROLLED for (Py_ssize_t j = 0; j < k; j++) {
                const double value = row.values[i * k + j];
                row.values[i * k + j] = sum[j];
                sum[j] = i == window - 1 ? value : sum[j] + value;
            }
        return;
    }
    double *after = row.begun; /* adds up, and is zero again in the end */
    for (Py_ssize_t i = window - 1; i >= 0; i--)
        for (Py_ssize_t j = 0; j < k; j++) {
            const double value = row.values[i * k + j];
            row.values[i * k + j] = after[j];
            after[j] = i == window - 1 ? value : after[j] + value;
        }
    for (Py_ssize_t j = 0; j < k; j++)
        row.begun[j] = 0.0;
}

/* Some samples of a window that is not full before them; sums of residual j from sums + j * across on, `down` apart, and
 * v likewise. */
INLINE void
fill_window(window_row row, Py_ssize_t at, const double *restrict v, double *restrict sums, Py_ssize_t some,
            Py_ssize_t k, Py_ssize_t v_down, Py_ssize_t v_across, Py_ssize_t down, Py_ssize_t across)
{
    double *place = row.values + at * k;
    if (FEW(k)) {
        double begun[4];
        Py_ssize_t i = 0;
        UNROLLED for (Py_ssize_t j = 0; j < k; j++)
            begun[j] = row.begun[j];
        if (at == 0) { /* from zero it would be 0 where this is -0 */
            UNROLLED for (Py_ssize_t j = 0; j < k; j++) {
                begun[j] = v[j * v_across];
                sums[j * across] = place[j] + begun[j];
                place[j] = begun[j];
            }
            i = 1;
        }
        for (; i < some; i++)
            UNROLLED for (Py_ssize_t j = 0; j < k; j++) {
                const double value = v[i * v_down + j * v_across], before = place[i * k + j];
                begun[j] += value;
                place[i * k + j] = value;
                sums[i * down + j * across] = before + begun[j];
            }
        UNROLLED for (Py_ssize_t j = 0; j < k; j++)
            row.begun[j] = begun[j];
        return;
    }
    for (Py_ssize_t i = 0; i < some; i++, place += k, v += v_down, sums += down)
        for (Py_ssize_t j = 0; j < k; j++) {
            const double value = v[j * v_across], begun = at + i ? row.begun[j] + value : value;
            row.begun[j] = begun;
            sums[j * across] = place[j] + begun;
            place[j] = value;
        }
}

/* The sums over the last samples, as residua.decide.window has them: of residual j from sums + j * across on. */
INLINE void
spread_sums(window_row row, Py_ssize_t window, const double *v, double *sums, Py_ssize_t time, Py_ssize_t k,
            Py_ssize_t v_down, Py_ssize_t v_across, Py_ssize_t down, Py_ssize_t across)
{
    if (window == 1) {
        for (Py_ssize_t i = 0; i < time; i++)
            for (Py_ssize_t j = 0; j < k; j++)
                sums[i * down + j * across] = v[i * v_down + j * v_across];
        return;
    }
    while (time > 0) {
        const Py_ssize_t at = (Py_ssize_t)*row.filled, room = window - at, some = time < room ? time : room;
        fill_window(row, at, v, sums, some, k, v_down, v_across, down, across);
        v += some * v_down;
        sums += some * down;
        *row.filled = at + some;
        if (some == room)
            turn_window(row, window, k);
        time -= some;
    }
}

INLINE void
moving_sums(window_row row, Py_ssize_t window, const double *v, double *sums, Py_ssize_t time, Py_ssize_t k)
{
    spread_sums(row, window, v, sums, time, k, k, 1, k, 1);
}

/* The same of those samples alone that are judged: at the others no window moves on, and the sums are zero. */
INLINE void
spread_sums_of_judged(window_row row, Py_ssize_t window, const double *v, double *sums, const flag *usable,
                      Py_ssize_t time, Py_ssize_t k, Py_ssize_t v_down, Py_ssize_t v_across, Py_ssize_t down,
                      Py_ssize_t across)
{
    for (Py_ssize_t i = 0; i < time;) {
        const flag *const end = memchr(usable + i, 0, (size_t)(time - i));
        const Py_ssize_t some = end == NULL ? time - i : end - (usable + i);
        spread_sums(row, window, v + i * v_down, sums + i * down, some, k, v_down, v_across, down, across);
        for (i += some; i < time && !usable[i]; i++)
            for (Py_ssize_t j = 0; j < k; j++)
                sums[i * down + j * across] = 0.0;
    }
}

INLINE void
sums_of_judged(window_row row, Py_ssize_t window, const piece *p, Py_ssize_t k)
{
    spread_sums_of_judged(row, window, p->q, p->sums, p->usable, p->time, k, k, 1, k, 1);
}

/* Alarms of statistics, NaN where nothing is decided; an alarm of a test that remembers is raised and ended at once. */
INLINE void
raise_alarms(const test_plan *t, const test_row *row, piece *p)
{
    const double largest = largest_of(p->statistic, p->time);
    whole up = *row->up, down = *row->down;
    flag alarm = *row->alarm;
    p->is_quiet = !(largest > t->threshold) && !up && !alarm;
    if (p->is_quiet && all_set(p->usable, p->time)) {
        *row->down = down + p->time;
        return;
    }
    p->is_quiet = 0;
    for (Py_ssize_t i = 0; i < p->time; i++) {
        const double statistic = p->statistic[i];
        const int over = p->usable[i] && statistic > t->threshold;
        if (p->usable[i]) {
            up = over ? up + 1 : 0;
            down = over ? 0 : down + 1;
            if (t->kind == NORM ? (over ? up >= t->persistence : down >= t->release)
                                : (over || statistic <= t->release_level))
                alarm = (flag)over;
        }
        p->over[i] = (flag)over;
        p->alarm[i] = alarm;
        p->up[i] = up;
    }
    *row->up = up;
    *row->down = down;
    *row->alarm = alarm;
}

INLINE void
judge_norm(const test_plan *t, const test_row *row, piece *p, Py_ssize_t k, int has_squares)
{
    if (t->window > 1) {
        sums_of_judged(row->window, t->window, p, k);
        for (Py_ssize_t i = 0; i < p->time; i++)
            p->statistic[i] = square_of(p->sums + i * k, k);
        roots(p->statistic, p->time);
        for (Py_ssize_t i = 0; i < p->time; i++)
            p->statistic[i] /= t->root;
    } else {
        if (!has_squares)
            for (Py_ssize_t i = 0; i < p->time; i++)
                p->statistic[i] = square_of(p->q + i * k, k);
        roots(p->statistic, p->time);
    }
    if (!all_set(p->usable, p->time))
        for (Py_ssize_t i = 0; i < p->time; i++)
            p->statistic[i] = p->usable[i] ? p->statistic[i] : NAN;
}

/* ---- tests that remember --------------------------------------------------------------------------------------- */

/* What the past does not foretell of q; whether all of the past that it takes is known. */
INLINE int
unforetold(const test_plan *t, const test_row *row, const double *q, int usable, double *e, double *part, Py_ssize_t k)
{
    const Py_ssize_t order = t->order;
    int seen = usable;
    for (Py_ssize_t j = 0; j < k; j++)
        e[j] = q[j];
    for (Py_ssize_t lag = 1; lag <= order; lag++) {
        row_product(row->past + (order - lag) * k, t->coefficients + (lag - 1) * k * k, k, k, part);
        for (Py_ssize_t j = 0; j < k; j++)
            e[j] -= part[j];
        seen &= row->past_usable[order - lag];
    }
    memmove(row->past, row->past + k, (size_t)((order - 1) * k) * sizeof(double));
    for (Py_ssize_t j = 0; j < k; j++)
        row->past[(order - 1) * k + j] = q[j];
    memmove(row->past_usable, row->past_usable + 1, (size_t)(order - 1));
    row->past_usable[order - 1] = (flag)usable;
    for (Py_ssize_t j = 0; j < k; j++)
        part[j] = seen ? e[j] : 0.0;
    row_product(part, t->rewhitening, k, k, e);
    return seen;
}

INLINE double
score_of(const double *knots, const double *scores, Py_ssize_t count, double value)
{
    Py_ssize_t low = 0, high = count; /* the first knot that is not below the value */
    while (low < high) {
        const Py_ssize_t middle = (low + high) / 2;
        if (knots[middle] < value)
            low = middle + 1;
        else
            high = middle;
    }
    const Py_ssize_t place = low < 1 ? 1 : low > count - 1 ? count - 1 : low;
    const double slope = (scores[place] - scores[place - 1]) / (knots[place] - knots[place - 1]);
    return scores[place - 1] + slope * (value - knots[place - 1]);
}

INLINE double
page(const test_plan *t, const double *now, const double *e, double *then, Py_ssize_t k)
{
    const double full = FULL * t->threshold;
    double largest = 0.0;
    for (Py_ssize_t j = 0; j < 2 * k; j++) {
        double sum = now[j] + ((j < k ? e[j] : -e[j - k]) - t->allowance);
        sum = sum > 0.0 ? sum : 0.0;
        then[j] = sum < full ? sum : full;
        largest = then[j] > largest ? then[j] : largest;
    }
    return largest;
}

INLINE double
crosier(const test_plan *t, const double *now, const double *e, double *then, Py_ssize_t k)
{
    const double full = FULL * t->threshold;
    UNROLLED for (Py_ssize_t j = 0; j < k; j++)
        then[j] = now[j] + e[j];
    const double length = length_of(then, k), above = length - t->allowance;
    double left = above > 0.0 ? above : 0.0;
    left = left < full ? left : full;
    const double part = length > 0 ? left / length : 0.0;
    UNROLLED for (Py_ssize_t j = 0; j < k; j++)
        then[j] *= part;
    return left;
}

INLINE double
pignatiello_runger(const test_plan *t, const double *now, const double *e, double *then, Py_ssize_t k)
{
    const double count = now[k] + 1, full = FULL * t->threshold;
    UNROLLED for (Py_ssize_t j = 0; j < k; j++)
        then[j] = now[j] + e[j];
    const double length = length_of(then, k), above = length - t->allowance * count;
    double left = above > 0.0 ? above : 0.0;
    if (isfinite(full)) {
        const double most = full + t->allowance * count;
        const double part = left > full ? most / (length > 0 ? length : 1.0) : 1.0;
        UNROLLED for (Py_ssize_t j = 0; j < k; j++)
            then[j] *= part;
        left = left < full ? left : full;
    }
    then[k] = count;
    if (!(left > 0))
        for (Py_ssize_t j = 0; j <= k; j++)
            then[j] = 0.0;
    return left;
}

/* ---- Crosier's sums of a long piece, part by part at the same time ------------------------------------------------ */

#define LANES 16       /* parts of a piece */
#define LEAST_LANE 128 /* samples of a part, at least */
#define CHECKED 16     /* samples after which parts are compared */
#define MAX_LANED 6    /* residuals, at most: the more there are, the longer it takes until sums come together */

#if defined(HAVE_AVX2)
/* Four numbers, one of each of four parts. */
AVX2 INLINE __m256d
one_of_each(const double *of, Py_ssize_t apart)
{
    return _mm256_setr_pd(of[0], of[apart], of[2 * apart], of[3 * apart]);
}

/* Four samples, one of each of four parts: `e` is added to the sums `now`; the statistic. */
#define DEFINE_SHORTENED(K)                                                                                           \
    AVX2 INLINE __m256d shortened_##K(const __m256d *e, double *now, __m256d allowance, __m256d full)                 \
    {                                                                                                                 \
        const __m256d zero = _mm256_setzero_pd();                                                                     \
        __m256d sum[K], total = zero;                                                                                 \
        _Pragma("GCC unroll 8") for (int j = 0; j < K; j++)                                                           \
        {                                                                                                             \
            sum[j] = _mm256_add_pd(_mm256_load_pd(now + j * LANES), e[j]);                                            \
            total = _mm256_add_pd(total, _mm256_mul_pd(sum[j], sum[j]));                                              \
        }                                                                                                             \
        const __m256d length = _mm256_sqrt_pd(total), above = _mm256_sub_pd(length, allowance);                       \
        const __m256d left = _mm256_min_pd(_mm256_max_pd(above, zero), full);                                         \
        const __m256d is_long = _mm256_cmp_pd(length, zero, _CMP_GT_OQ);                                              \
        const __m256d part = _mm256_and_pd(_mm256_div_pd(left, length), is_long);                                     \
        _Pragma("GCC unroll 8") for (int j = 0; j < K; j++)                                                           \
            _mm256_store_pd(now + j * LANES, _mm256_mul_pd(sum[j], part));                                            \
        return left;                                                                                                  \
    }

AVX2 INLINE void
put_one_of_each(double *to, Py_ssize_t apart, __m256d values)
{
    const __m128d low = _mm256_castpd256_pd128(values), high = _mm256_extractf128_pd(values, 1);
    _mm_storel_pd(to, low);
    _mm_storeh_pd(to + apart, low);
    _mm_storel_pd(to + 2 * apart, high);
    _mm_storeh_pd(to + 3 * apart, high);
}

/* Some samples of all parts, from `from` on; those of one part lie `each` samples behind those of the one before. */
#define DEFINE_LANES(K)                                                                                               \
    DEFINE_SHORTENED(K)                                                                                               \
    AVX2 static void crosier_lanes_##K(const test_plan *t, double *restrict now, const piece *p, Py_ssize_t from,     \
                                       Py_ssize_t some, Py_ssize_t each)                                              \
    {                                                                                                                 \
        const __m256d allowance = _mm256_set1_pd(t->allowance), full = _mm256_set1_pd(FULL * t->threshold);           \
        const Py_ssize_t down = p->apart ? 1 : K, across = p->apart ? p->apart : 1, apart = each * down;              \
        for (Py_ssize_t i = from; i < from + some; i++) {                                                             \
            const double *at = p->e + i * down;                                                                       \
            double *to = p->statistic + i;                                                                            \
            _Pragma("GCC unroll 4") for (int l = 0; l < LANES; l += 4, at += 4 * apart, to += 4 * each)               \
            {                                                                                                         \
                __m256d e[K];                                                                                         \
                _Pragma("GCC unroll 8") for (int j = 0; j < K; j++) e[j] = one_of_each(at + j * across, apart);       \
                put_one_of_each(to, each, shortened_##K(e, now + l, allowance, full));                                \
            }                                                                                                         \
        }                                                                                                             \
    }
DEFINE_LANES(1)
DEFINE_LANES(2)
DEFINE_LANES(3)
DEFINE_LANES(4)
DEFINE_LANES(5)
DEFINE_LANES(6)

/* The same of residuals that are whitened here, as many as there are: while roots and quotients are waited for, that
 * costs little, also where a sample is read twice. */
#define DEFINE_RAW_LANES(K)                                                                                           \
    AVX2 static void raw_lanes_##K(const test_plan *t, double *restrict now, const piece *p, Py_ssize_t from,         \
                                   Py_ssize_t some, Py_ssize_t each)                                                  \
    {                                                                                                                 \
        const __m256d allowance = _mm256_set1_pd(t->allowance), full = _mm256_set1_pd(FULL * t->threshold);           \
        __m256d center[K], whitening[K * K];                                                                          \
        for (int j = 0; j < K; j++)                                                                                   \
            center[j] = _mm256_set1_pd(t->center[j]);                                                                 \
        for (int j = 0; j < K * K; j++)                                                                               \
            whitening[j] = _mm256_set1_pd(t->whitening[j]);                                                           \
        for (Py_ssize_t i = from; i < from + some; i++) {                                                             \
            const double *at = p->r + i * K;                                                                          \
            double *to = p->statistic + i;                                                                            \
            _Pragma("GCC unroll 4") for (int l = 0; l < LANES; l += 4, at += 4 * each * K, to += 4 * each)            \
            {                                                                                                         \
                __m256d e[K];                                                                                         \
                _Pragma("GCC unroll 4") for (int j = 0; j < K; j++) e[j] = _mm256_setzero_pd();                       \
                _Pragma("GCC unroll 4") for (int j = 0; j < K; j++)                                                   \
                {                                                                                                     \
                    const __m256d centred = _mm256_sub_pd(one_of_each(at + j, each * K), center[j]);                  \
                    _Pragma("GCC unroll 4") for (int c = 0; c < K; c++)                                               \
                        e[c] = _mm256_add_pd(e[c], _mm256_mul_pd(centred, whitening[j * K + c]));                     \
                }                                                                                                     \
                put_one_of_each(to, each, shortened_##K(e, now + l, allowance, full));                                \
            }                                                                                                         \
        }                                                                                                             \
    }
DEFINE_RAW_LANES(1)
DEFINE_RAW_LANES(2)
DEFINE_RAW_LANES(3)
DEFINE_RAW_LANES(4)
typedef void (*lanes_runner)(const test_plan *, double *, const piece *, Py_ssize_t, Py_ssize_t, Py_ssize_t);
static const lanes_runner lanes_table[MAX_LANED] = {crosier_lanes_1, crosier_lanes_2, crosier_lanes_3,
                                                    crosier_lanes_4, crosier_lanes_5, crosier_lanes_6};
static const lanes_runner raw_table[4] = {raw_lanes_1, raw_lanes_2, raw_lanes_3, raw_lanes_4};

/* Some samples of a piece from one on, which are cut into parts. Each part begins at zero, and then again with what the one
 * before has left: sums that begin apart come together, to the last bit, as what is left of either is shortened each
 * time. How many samples that were: the parts before one with an alarm; 0, where they do not come together within their
 * part. The statistics of all others are to be formed anew. `room` is for what has been at some samples. */
static Py_ssize_t
crosier_by_parts(const test_plan *t, double *sums, const piece *p, Py_ssize_t begin, double *room, Py_ssize_t k)
{
    const Py_ssize_t each = (p->time - begin) / LANES / CHECKED * CHECKED, size = k * LANES;
    if (!p->is_laned || k > MAX_LANED || each < LEAST_LANE || !all_set(p->usable, p->time))
        return 0;
    double now[MAX_LANED * LANES] __attribute__((aligned(32)));
    double *const ends = room + each / CHECKED * size;
    const lanes_runner run = p->is_raw ? raw_table[k - 1] : lanes_table[k - 1];
    for (Py_ssize_t j = 0; j < size; j++)
        now[j] = j % LANES == 0 ? sums[j / LANES] : 0.0;
    for (Py_ssize_t i = 0; i < each; i += CHECKED) {
        run(t, now, p, begin + i, CHECKED, each);
        memcpy(room + i / CHECKED * size, now, (size_t)size * sizeof(double));
    }
    const double *const statistic = p->statistic + begin;
    if (!(largest_of(statistic, each) <= t->threshold)) /* the first part, which began as it is, has an alarm */
        return 0;
    memcpy(ends, now, (size_t)size * sizeof(double));
    for (Py_ssize_t j = 0; j < size; j++)
        now[j] = j % LANES == 0 ? sums[j / LANES] : ends[j - 1];
    int differs = 1;
    for (Py_ssize_t i = 0; i < each && differs; i += CHECKED) {
        run(t, now, p, begin + i, CHECKED, each);
        differs = memcmp(room + i / CHECKED * size, now, (size_t)size * sizeof(double)) != 0;
    }
    if (differs)
        return 0;
    Py_ssize_t parts = 0; /* before the first alarm */
    while (parts < LANES && largest_of(statistic + parts * each, each) <= t->threshold)
        parts++;
    for (Py_ssize_t j = 0; j < k && parts; j++)
        sums[j] = ends[j * LANES + parts - 1];
    return parts * each;
}
#else
INLINE Py_ssize_t
crosier_by_parts(const test_plan *t, double *sums, const piece *p, Py_ssize_t begin, double *room, Py_ssize_t k)
{
    (void)t, (void)sums, (void)p, (void)begin, (void)room, (void)k;
    return 0;
}
#endif

/* Put whitened residuals into rows, from some sample on: those that lie in columns, or are not there yet. */
INLINE void
in_rows(const test_plan *t, piece *p, Py_ssize_t from, Py_ssize_t k)
{
    if (p->is_raw)
        for (Py_ssize_t i = from; i < p->time; i++)
            whitened_of(t, p->r + i * k, p->q + i * k, k, k);
    if (p->apart) {
        for (Py_ssize_t i = from; i < p->time; i++)
            for (Py_ssize_t j = 0; j < k; j++)
                p->rows[i * k + j] = p->q[j * p->apart + i];
        p->e = p->rows;
    }
    p->apart = 0;
    p->is_raw = 0;
}

/* Cumulative sums of a piece; `sums` of one plant, and whether it is in alarm behind them. */
INLINE void
cumulative_sums(const test_plan *t, double *sums, piece *p, double *then, Py_ssize_t k)
{
    const Py_ssize_t count = t->sums - 1;
    int alarmed = sums[count] > 0, by_parts = t->kind == CROSIER; /* as long as that comes to an end */
    int is_over = !alarmed;                                       /* the last alarm, just now */
    for (Py_ssize_t i = 0; i < p->time; i++) {
        if (by_parts && is_over) {
            const Py_ssize_t done = crosier_by_parts(t, sums, p, i, p->history, k);
            by_parts = done > 0;
            i += done;
            if (i == p->time)
                break;
        }
        is_over = 0;
        if (p->apart || p->is_raw)
            in_rows(t, p, i, k);
        const double *e = p->e + i * k;
        const double value = t->kind == PAGE      ? page(t, sums, e, then, k)
                             : t->kind == CROSIER ? crosier(t, sums, e, then, k)
                                                  : pignatiello_runger(t, sums, e, then, k);
        p->statistic[i] = value;
        if (!p->usable[i])
            continue;
        alarmed |= value > t->threshold;
        if (alarmed && value <= t->release_level) {
            for (Py_ssize_t j = 0; j < count; j++)
                then[j] = 0.0;
            alarmed = 0;
            is_over = 1;
        }
        for (Py_ssize_t j = 0; j < count; j++)
            sums[j] = then[j];
    }
    sums[count] = alarmed ? 1.0 : 0.0;
}

/* Weighted averages of a piece. */
INLINE void
averages(const test_plan *t, double *sums, piece *p, Py_ssize_t k)
{
    for (Py_ssize_t i = 0; i < p->time; i++) {
        const double *e = p->e + i * k;
        for (Py_ssize_t j = 0; j < k; j++)
            sums[j] = p->usable[i] ? t->old_weight * sums[j] + t->new_weight * e[j] : sums[j];
        p->statistic[i] = square_of(sums, k);
    }
    roots(p->statistic, p->time);
    for (Py_ssize_t i = 0; i < p->time; i++)
        p->statistic[i] /= t->deviation;
}

/* ---- sums over the last samples that were seen, of a piece; so many are remembered ------------------------------- */

#define TOGETHER 8 /* samples whose sums are formed side by side */

/* The largest size of the sums that end at some samples, each by the root of its number of samples. The columns are so
 * far apart; `total` has room for as many numbers of each column. */
INLINE void
best_of_sums(const test_plan *t, const double *columns, Py_ssize_t apart, Py_ssize_t width, double *restrict total,
             double *restrict best)
{
    for (Py_ssize_t j = 0; j < width * TOGETHER; j++)
        total[j] = 0.0;
    for (int l = 0; l < TOGETHER; l++)
        best[l] = 0.0;
    for (Py_ssize_t back = 0; back < t->window; back++) {
        double size[TOGETHER] = {0.0};
        for (Py_ssize_t j = 0; j < width; j++) {
            const double *sample = columns + j * apart - back;
            double *sum = total + j * TOGETHER;
            for (int l = 0; l < TOGETHER; l++)
                sum[l] += sample[l];
            if (t->kind == GLR)
                for (int l = 0; l < TOGETHER; l++)
                    size[l] += sum[l] * sum[l];
            else
                for (int l = 0; l < TOGETHER; l++)
                    size[l] = fabs(sum[l]) > size[l] ? fabs(sum[l]) : size[l];
        }
        const double root = sqrt((double)(back + 1));
        if (t->kind == GLR)
            for (int l = 0; l < TOGETHER; l++)
                size[l] = sqrt(size[l]);
        for (int l = 0; l < TOGETHER; l++) {
            size[l] /= root;
            best[l] = back == 0 || size[l] > best[l] ? size[l] : best[l];
        }
    }
}

/* The sums themselves, of one column. */
INLINE void
sums_of_recent(const test_plan *t, const double *sample, double *restrict best)
{
    double total[TOGETHER] = {0.0};
    for (Py_ssize_t back = 0; back < t->window; back++)
        for (int l = 0; l < TOGETHER; l++)
            total[l] += sample[l - back];
    for (int l = 0; l < TOGETHER; l++)
        best[l] = total[l];
}

/* What is summed of a sample: its square, itself, or its parts along directions. */
INLINE void
summed_part(const test_plan *t, const double *e, double *part, Py_ssize_t k)
{
    if (t->kind == CHI_SQUARED)
        part[0] = square_of(e, k);
    else if (t->kind == DIRECTED_GLR)
        row_product(e, t->along, k, t->directions, part);
    else
        for (Py_ssize_t j = 0; j < k; j++)
            part[j] = e[j];
}

/* Statistics of sums over the last samples that were seen, of a piece; `sums` are these samples, the oldest first. If it
 * `has_squares`, all samples are seen, and `statistic` holds what chi-squared sums. */
INLINE void
of_recent(const test_plan *t, double *sums, piece *p, double *part, Py_ssize_t k, int has_squares)
{
    const Py_ssize_t width = t->kind == CHI_SQUARED ? 1 : t->kind == GLR ? k : t->directions, kept = t->window - 1;
    const Py_ssize_t apart = kept + p->time + TOGETHER;
    double *const columns = p->history, *const total = columns + width * apart;
    Py_ssize_t seen = kept;
    for (Py_ssize_t i = 0; i < kept; i++)
        for (Py_ssize_t j = 0; j < width; j++)
            columns[j * apart + i] = sums[i * width + j];
    if (has_squares && t->kind == CHI_SQUARED) {
        memcpy(columns + seen, p->statistic, (size_t)p->time * sizeof(double));
        seen += p->time;
    } else
        for (Py_ssize_t i = 0; i < p->time; i++)
            if (p->usable[i]) {
                summed_part(t, p->e + i * k, part, k);
                for (Py_ssize_t j = 0; j < width; j++)
                    columns[j * apart + seen] = part[j];
                seen++;
            }
    for (Py_ssize_t j = 0; j < width; j++)
        for (Py_ssize_t i = seen; i < seen + TOGETHER && i < apart; i++)
            columns[j * apart + i] = 0.0;
    for (Py_ssize_t i = kept; i < seen; i += TOGETHER) {
        double best[TOGETHER];
        if (t->kind == CHI_SQUARED)
            sums_of_recent(t, columns + i, best);
        else
            best_of_sums(t, columns + i, apart, width, total, best);
        for (Py_ssize_t l = 0; l < TOGETHER && i + l < seen; l++)
            p->statistic[i + l - kept] = best[l];
    }
    if (t->kind == CHI_SQUARED)
        roots(p->statistic, seen - kept);
    for (Py_ssize_t i = 0; i < kept; i++)
        for (Py_ssize_t j = 0; j < width; j++)
            sums[i * width + j] = columns[j * apart + seen - kept + i];
    Py_ssize_t from = seen - kept; /* from the last one on, each to its own place */
    for (Py_ssize_t i = p->time - 1; i >= 0 && from <= i; i--)
        if (p->usable[i])
            p->statistic[i] = p->statistic[--from];
}

#include "_means.h"

INLINE void
judge_stream(const test_plan *t, const test_row *row, piece *p, double *part, double *spare, Py_ssize_t k,
             int has_squares)
{
    if (!t->order && !t->knots_of_each) /* as it is */
        p->e = p->q;
    double *const e = p->e;
    if (t->order)
        for (Py_ssize_t i = 0; i < p->time; i++)
            p->usable[i] = (flag)unforetold(t, row, p->q + i * k, p->usable[i], e + i * k, part, k);
    else if (e != p->q)
        memcpy(e, p->q, (size_t)(p->time * k) * sizeof(double));
    if (t->knots_of_each)
        for (Py_ssize_t i = 0; i < p->time; i++)
            for (Py_ssize_t j = 0; j < k; j++)
                e[i * k + j] = score_of(t->knots + j * t->knots_of_each, t->scores, t->knots_of_each, e[i * k + j]);
    if (t->kind <= PIGNATIELLO_RUNGER)
        cumulative_sums(t, row->sums, p, part, k);
    else if (t->kind == EWMA)
        averages(t, row->sums, p, k);
    else if (t->kind == MEANS)
        longest_means(t, row->sums, p, k);
    else
        of_recent(t, row->sums, p, spare, k, has_squares && p->e == p->q);
    if (!all_set(p->usable, p->time))
        for (Py_ssize_t i = 0; i < p->time; i++)
            p->statistic[i] = p->usable[i] ? p->statistic[i] : NAN;
}

/* ---- isolation by direction ------------------------------------------------------------------------------------ */

/* The parts of a sum of residuals along all bases. */
INLINE void
parts_along(const isolation_plan *n, const double *sums, double *along, Py_ssize_t k, Py_ssize_t columns)
{
    for (Py_ssize_t c = 0; c < columns; c++)
        along[c] = 0.0;
    for (Py_ssize_t j = 0; j < k; j++)
        for (Py_ssize_t c = 0; c < columns; c++)
            along[c] += sums[j] * n->padded[j * n->room + c];
}

/* Of each number the root of its square, which is its size where the square does not become too small. */
INLINE void
each_length(double *values, Py_ssize_t count)
{
    double near[8] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0}; /* lanes of vectors */
    Py_ssize_t c = 0;
    for (; c + 8 <= count; c += 8)
        for (int l = 0; l < 8; l++)
            near[l] = (fabs(values[c + l]) >= 1e-150) | (values[c + l] == 0.0) ? near[l] : 1.0;
    for (; c < count; c++)
        near[0] = (fabs(values[c]) >= 1e-150) | (values[c] == 0.0) ? near[0] : 1.0;
    double any = 0.0;
    for (int l = 0; l < 8; l++)
        any += near[l];
    if (any == 0.0) {
        for (c = 0; c < count; c++)
            values[c] = fabs(values[c]);
        return;
    }
    for (c = 0; c < count; c++)
        values[c] = sqrt(values[c] * values[c]);
}

INLINE void
shares_of(double *values, double size, Py_ssize_t count)
{
    for (Py_ssize_t c = 0; c < count; c++) {
        const double score = values[c] / size;
        values[c] = score > 1.0 ? 1.0 : score; /* NaN where infinite sums are compared */
    }
}

INLINE void
clear_doubles(void *to, Py_ssize_t count)
{
    for (Py_ssize_t j = 0; j < count; j++)
        ((double *)to)[j] = 0.0;
}

/* How well each signature explains one sum; NaN where nothing can be said. `part` has room for all columns. */
INLINE void
score_sample(const isolation_plan *n, const double *sums, int usable, double *part, double *scores, Py_ssize_t k)
{
    const double size = length_of(sums, k);
    if (!(usable && size > 0)) {
        for (Py_ssize_t g = 0; g < n->groups; g++)
            scores[g] = NAN;
        return;
    }
    if (n->are_lines && n->room == 8) { /* constants: in registers */
        double along[8];
        parts_along(n, sums, along, k, 8);
        each_length(along, 8);
        shares_of(along, size, 8);
        for (Py_ssize_t g = 0; g < n->groups; g++)
            scores[g] = along[g];
        return;
    }
    parts_along(n, sums, part, k, n->columns);
    if (n->are_lines) {
        for (Py_ssize_t g = 0; g < n->groups; g++)
            scores[g] = sqrt(part[g] * part[g]);
    } else
        for (Py_ssize_t g = 0; g < n->groups; part += n->dimensions[g++])
            scores[g] = length_of(part, (Py_ssize_t)n->dimensions[g]);
    shares_of(scores, size, n->groups);
}

INLINE void
squares_of_columns(const double *restrict columns, double *restrict total, Py_ssize_t time, Py_ssize_t k)
{
    if (FEW(k)) {
        for (Py_ssize_t i = 0; i < time; i++) {
            double sum = 0.0;
            UNROLLED for (Py_ssize_t j = 0; j < k; j++)
                sum += columns[j * time + i] * columns[j * time + i];
            total[i] = sum;
        }
        return;
    }
    clear_doubles(total, time);
    for (Py_ssize_t j = 0; j < k; j++)
        for (Py_ssize_t i = 0; i < time; i++)
            total[i] += columns[j * time + i] * columns[j * time + i];
}

/* The parts of sums, which lie in columns, along one direction. */
INLINE void
columns_along(const isolation_plan *n, const double *restrict columns, double *restrict along, Py_ssize_t time,
              Py_ssize_t k, Py_ssize_t which)
{
    const double *const part = n->padded + which;
    if (FEW(k)) {
        double weight[4];
        for (Py_ssize_t j = 0; j < k; j++)
            weight[j] = part[j * n->room];
        for (Py_ssize_t i = 0; i < time; i++) {
            double sum = 0.0;
            UNROLLED for (Py_ssize_t j = 0; j < k; j++)
                sum += columns[j * time + i] * weight[j];
            along[i] = sum;
        }
        return;
    }
    clear_doubles(along, time);
    for (Py_ssize_t j = 0; j < k; j++) {
        const double weight = part[j * n->room];
        for (Py_ssize_t i = 0; i < time; i++)
            along[i] += columns[j * time + i] * weight;
    }
}

/* The same of a piece, column by column: all samples of one at once. `sums` are the columns of the sums, with room for
 * three more behind them. */
INLINE void
score_columns(const isolation_plan *n, const piece *p, double *sums, Py_ssize_t k)
{
    const Py_ssize_t time = p->time, groups = n->groups;
    double *restrict size = sums + k * time, *restrict along = size + time, *restrict total = along + time;
    squares_of_columns(sums, size, time, k);
    roots(size, time);
    Py_ssize_t column = 0;
    for (Py_ssize_t g = 0; g < groups; g++) {
        if (n->are_lines) {
            columns_along(n, sums, total, time, k, column++);
            each_length(total, time);
        } else {
            clear_doubles(total, time);
            for (whole d = 0; d < n->dimensions[g]; d++) {
                columns_along(n, sums, along, time, k, column++);
                for (Py_ssize_t i = 0; i < time; i++)
                    total[i] += along[i] * along[i];
            }
            roots(total, time);
        }
        for (Py_ssize_t i = 0; i < time; i++) {
            const double score = size[i] > 0.0 ? total[i] / size[i] : NAN; /* a part may be more than its rounded whole */
            along[i] = score > 1.0 ? 1.0 : score;
        }
        for (Py_ssize_t i = 0; i < time; i++)
            p->scores[i * groups + g] = along[i];
    }
    if (all_set(p->usable, time))
        return;
    for (Py_ssize_t i = 0; i < time; i++)
        for (Py_ssize_t g = 0; !p->usable[i] && g < groups; g++)
            p->scores[i * groups + g] = NAN;
}

#if defined(HAVE_AVX2)
#define TINY 1e-150 /* the square of a smaller number may be too small */

/* Scores of lines, of four samples at once: of so many groups, from `first` on; whether none is near zero. */
AVX2 INLINE __m256d
score_four(const isolation_plan *n, const __m256d *sums, __m256d size, Py_ssize_t group, Py_ssize_t k, __m256d *near)
{
    const __m256d zero = _mm256_setzero_pd(), one = _mm256_set1_pd(1.0);
    const double *const part = n->padded + group;
    __m256d along = _mm256_mul_pd(sums[0], _mm256_broadcast_sd(part));
    for (Py_ssize_t j = 1; j < k; j++)
        along = _mm256_add_pd(along, _mm256_mul_pd(sums[j], _mm256_broadcast_sd(part + j * n->room)));
    along = _mm256_andnot_pd(_mm256_set1_pd(-0.0), along);
    const __m256d is_small = _mm256_cmp_pd(along, _mm256_set1_pd(TINY), _CMP_NGE_UQ);
    *near = _mm256_or_pd(*near, _mm256_and_pd(is_small, _mm256_cmp_pd(along, zero, _CMP_NEQ_UQ)));
    const __m256d is_long = _mm256_cmp_pd(size, zero, _CMP_GT_OQ);
    return _mm256_min_pd(one, _mm256_blendv_pd(_mm256_set1_pd(NAN), _mm256_div_pd(along, size), is_long));
}

/* As score_columns, where every signature has one column: as many samples as there are four and four; 0, and nothing
 * to be read of the scores, where roots of squares are needed. */
#define DEFINE_SCORES(K)                                                                                              \
    AVX2 static int score_lines_##K(const isolation_plan *n, const piece *p, const double *columns)                   \
    {                                                                                                                 \
        const Py_ssize_t time = p->time, groups = n->groups;                                                          \
        __m256d near = _mm256_setzero_pd();                                                                           \
        for (Py_ssize_t i = 0; i + 4 <= time; i += 4) {                                                               \
            double *const to = p->scores + i * groups;                                                                \
            __m256d sums[K], size = _mm256_setzero_pd();                                                              \
            _Pragma("GCC unroll 4") for (int j = 0; j < K; j++)                                                       \
            {                                                                                                         \
                sums[j] = _mm256_loadu_pd(columns + j * time + i);                                                    \
                size = _mm256_add_pd(size, _mm256_mul_pd(sums[j], sums[j]));                                          \
            }                                                                                                         \
            size = _mm256_sqrt_pd(size);                                                                              \
            Py_ssize_t g = 0;                                                                                         \
            for (; g + 4 <= groups; g += 4) {                                                                         \
                const __m256d a = score_four(n, sums, size, g, K, &near);                                             \
                const __m256d b = score_four(n, sums, size, g + 1, K, &near);                                         \
                const __m256d c = score_four(n, sums, size, g + 2, K, &near);                                         \
                const __m256d d = score_four(n, sums, size, g + 3, K, &near);                                         \
                const __m256d low = _mm256_unpacklo_pd(a, b), high = _mm256_unpackhi_pd(a, b);                        \
                const __m256d low_too = _mm256_unpacklo_pd(c, d), high_too = _mm256_unpackhi_pd(c, d);                \
                _mm256_storeu_pd(to + g, _mm256_permute2f128_pd(low, low_too, 0x20));                                 \
                _mm256_storeu_pd(to + groups + g, _mm256_permute2f128_pd(high, high_too, 0x20));                      \
                _mm256_storeu_pd(to + 2 * groups + g, _mm256_permute2f128_pd(low, low_too, 0x31));                    \
                _mm256_storeu_pd(to + 3 * groups + g, _mm256_permute2f128_pd(high, high_too, 0x31));                  \
            }                                                                                                         \
            for (; g < groups; g++) {                                                                                 \
                const __m256d a = score_four(n, sums, size, g, K, &near);                                             \
                const __m128d low = _mm256_castpd256_pd128(a), high = _mm256_extractf128_pd(a, 1);                    \
                _mm_storel_pd(to + g, low);                                                                           \
                _mm_storeh_pd(to + groups + g, low);                                                                  \
                _mm_storel_pd(to + 2 * groups + g, high);                                                             \
                _mm_storeh_pd(to + 3 * groups + g, high);                                                             \
            }                                                                                                         \
        }                                                                                                             \
        return _mm256_testz_si256(_mm256_castpd_si256(near), _mm256_castpd_si256(near));                              \
    }
DEFINE_SCORES(1)
DEFINE_SCORES(2)
DEFINE_SCORES(3)
DEFINE_SCORES(4)

static int
score_lines(const isolation_plan *n, const piece *p, const double *columns, double *part, Py_ssize_t k)
{
    static int (*const table[4])(const isolation_plan *, const piece *, const double *) = {
        score_lines_1, score_lines_2, score_lines_3, score_lines_4};
    const Py_ssize_t time = p->time, begun = time / 4 * 4;
    if (!p->is_laned || !n->are_lines || k > 4 || !all_set(p->usable, time) || !table[k - 1](n, p, columns))
        return 0;
    for (Py_ssize_t i = begun; i < time; i++) {
        double sums[4];
        for (Py_ssize_t j = 0; j < k; j++)
            sums[j] = columns[j * time + i];
        score_sample(n, sums, 1, part, p->scores + i * n->groups, k);
    }
    return 1;
}
#else
INLINE int
score_lines(const isolation_plan *n, const piece *p, const double *columns, double *part, Py_ssize_t k)
{
    (void)n, (void)p, (void)columns, (void)part, (void)k;
    return 0;
}
#endif

#define LONG_MEANS 2
static const double LONG_WEIGHTS[LONG_MEANS] = {0.125, 0.015625}; /* as residua.decide.directional has them */

/* Put the long means of one sample on, and a longer one in the place of the sample where it is clear, or no shorter. */
INLINE void
clear_mean(double *means, double clear, const double *v, double *chosen, Py_ssize_t across, Py_ssize_t k)
{
    double longest = square_of(v, k);
    const int is_zero = longest == 0.0 && all_within(v, k, 0.0);
    for (Py_ssize_t j = 0; j < k; j++)
        chosen[j * across] = v[j];
    for (int s = 0; s < LONG_MEANS; s++) {
        double *const mean = means + s * k;
        const double weight = LONG_WEIGHTS[s], factor = (2.0 - weight) / weight;
        for (Py_ssize_t j = 0; j < k; j++)
            mean[j] = (1.0 - weight) * mean[j] + weight * v[j];
        const double square = square_of(mean, k) * factor;
        if (square > clear || square >= longest) {
            longest = square;
            for (Py_ssize_t j = 0; j < k; j++)
                chosen[j * across] = mean[j];
        }
        for (Py_ssize_t j = 0; is_zero && j < k; j++)
            mean[j] = fabs(mean[j]) < 0x1p-500 ? 0.0 : mean[j];
    }
}

/* The same of a piece, of samples that lie in columns and none of which is zero: all samples at once. Behind the columns
 * are their squares, and room for LONG_MEANS as many and one. */
INLINE void
clear_means_of_piece(double *means, double clear, double *restrict chosen, Py_ssize_t time, Py_ssize_t k)
{
    double *restrict const longest = chosen + k * time, *restrict const rows = longest + time;
    double *restrict const taken = rows + LONG_MEANS * k * time;
    double now[4 * LONG_MEANS];
    for (Py_ssize_t j = 0; j < LONG_MEANS * k; j++)
        now[j] = means[j];
    for (Py_ssize_t i = 0; i < time; i++)
        UNROLLED for (int s = 0; s < LONG_MEANS; s++)
            UNROLLED for (Py_ssize_t j = 0; j < k; j++) {
                now[s * k + j] = (1.0 - LONG_WEIGHTS[s]) * now[s * k + j] + LONG_WEIGHTS[s] * chosen[j * time + i];
                rows[(s * k + j) * time + i] = now[s * k + j];
            }
    for (Py_ssize_t j = 0; j < LONG_MEANS * k; j++)
        means[j] = now[j];
    for (int s = 0; s < LONG_MEANS; s++) {
        const double *restrict const row = rows + s * k * time;
        const double factor = (2.0 - LONG_WEIGHTS[s]) / LONG_WEIGHTS[s];
        squares_of_columns(row, taken, time, k);
        for (Py_ssize_t i = 0; i < time; i++) {
            const double square = taken[i] * factor;
            taken[i] = (square > clear) | (square >= longest[i]) ? 1.0 : 0.0;
            longest[i] = taken[i] > 0.0 ? square : longest[i];
        }
        for (Py_ssize_t j = 0; j < k; j++)
            for (Py_ssize_t i = 0; i < time; i++)
                chosen[j * time + i] = taken[i] > 0.0 ? row[j * time + i] : chosen[j * time + i];
    }
}

/* The same of those samples that are judged: at the others no mean moves on, and what is chosen is zero. */
INLINE void
clear_means(const isolation_plan *n, double *means, const piece *p, double *columns, Py_ssize_t k)
{
    const Py_ssize_t time = p->time, down = p->apart ? 1 : k, across = p->apart ? p->apart : 1;
    if (FEW(k) && time >= 8 && all_set(p->usable, time)) {
        double *const squares = columns + k * time, least = INFINITY;
        for (Py_ssize_t j = 0; j < k; j++)
            if (p->apart)
                memcpy(columns + j * time, p->q + j * across, (size_t)time * sizeof(double));
            else
                for (Py_ssize_t i = 0; i < time; i++)
                    columns[j * time + i] = p->q[i * k + j];
        squares_of_columns(columns, squares, time, k);
        for (Py_ssize_t i = 0; i < time; i++)
            least = squares[i] < least ? squares[i] : least;
        if (least > 0.0) {
            clear_means_of_piece(means, n->clear, columns, time, k);
            return;
        }
    }
    for (Py_ssize_t i = 0; i < time; i++) {
        const double *v = p->q + i * down;
        double one[4];
        for (Py_ssize_t j = 0; p->apart && j < k; j++)
            one[j] = v[j * across];
        if (p->usable[i])
            clear_mean(means, n->clear, p->apart ? one : v, columns + i, time, k);
        else
            for (Py_ssize_t j = 0; j < k; j++)
                columns[j * time + i] = 0.0;
    }
}

INLINE void
name_by_direction(const isolation_plan *n, window_row row, const piece *p, double *part, double *columns, Py_ssize_t k)
{
    const Py_ssize_t time = p->time;
    if (!n->window)
        clear_means(n, row.values, p, columns, k);
    else
        spread_sums_of_judged(row, n->window, p->q, columns, p->usable, time, k, p->apart ? 1 : k,
                              p->apart ? p->apart : 1, 1, time);
    if (p->scores != NULL && time == 1)
        score_sample(n, columns, p->usable[0], part, p->scores, k);
    else if (p->scores != NULL && !score_lines(n, p, columns, part, k))
        score_columns(n, p, columns, k);
    for (Py_ssize_t j = 0; j < k; j++) /* what is kept of the last sample */
        p->sums[(time - 1) * k + j] = columns[j * time + time - 1];
}

#endif
