/* Tests and isolations of the fused loop: the same sums in the same order as their NumPy code.
 *
 * Each takes a piece of one plant, and its own row of the state. To bring a test of another kind here, write its statistic, a line in `statistic_of`, and `compiled` in its Python file.
 */
#ifndef RESIDUA_JUDGING_H
#define RESIDUA_JUDGING_H

#include <math.h>

#define LARGEST_WHITENED 1e120 /* as in residua.decide.whitened_norm */
#define FULL 2.0               /* as in residua.decide.cusum */

enum { NORM = 1, PAGE, CROSIER, PIGNATIELLO_RUNGER, EWMA, CHI_SQUARED, GLR, DIRECTED_GLR };

typedef unsigned char flag;
typedef long long whole;

/* A test with every number filled in; k whitened residuals of nr. */
typedef struct {
    int kind;
    Py_ssize_t nr, k, window, order, knots_of_each, sums, directions;
    whole persistence, release;
    double root; /* of the window */
    double threshold, release_level, allowance, old_weight, new_weight, deviation;
    double padded[16]; /* of at most four residuals: rows of the whitening, and zeros */
    const double *center, *whitening, *coefficients, *rewhitening, *knots, *scores, *along;
} test_plan;

typedef struct {
    Py_ssize_t k, window, groups;
    const whole *dimensions;
    const double *bases; /* k x all columns of all groups */
    Py_ssize_t columns;
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
    flag *usable, *over, *alarm;
    whole *up;
    int is_quiet; /* nothing is over, and nothing was: `over`, `alarm` and `up` are not written then */
} piece;

INLINE double
length_of(const double *v, Py_ssize_t k)
{
    double total = 0.0;
    for (Py_ssize_t j = 0; j < k; j++)
        total += v[j] * v[j];
    return sqrt(total);
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
    if (nr <= 4 && k <= 4) { /* constants: in registers, of rows that are padded with zeros */
        double sum[4] = {0.0, 0.0, 0.0, 0.0};
        for (Py_ssize_t i = 0; i < nr; i++) {
            const double centred = r[i] - t->center[i];
            for (int j = 0; j < 4; j++)
                sum[j] += centred * t->padded[4 * i + j];
        }
        for (Py_ssize_t j = 0; j < k; j++)
            q[j] = sum[j];
        return;
    }
    for (Py_ssize_t j = 0; j < k; j++)
        q[j] = 0.0;
    for (Py_ssize_t i = 0; i < nr; i++)
        for (Py_ssize_t j = 0; j < k; j++)
            q[j] += (r[i] - t->center[i]) * t->whitening[i * k + j];
}

/* Whitened residuals; 0 and not usable where one would overflow a sum. */
INLINE void
whiten(const test_plan *t, const piece *p, Py_ssize_t nr, Py_ssize_t k)
{
    if (all_set(p->usable, p->time)) {
        for (Py_ssize_t i = 0; i < p->time; i++)
            whitened_of(t, p->r + i * nr, p->q + i * k, nr, k);
        if (all_within(p->q, p->time * k, LARGEST_WHITENED))
            return;
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
}

/* The sum over the last samples, as residua.decide.window has it. */
INLINE void
moving_sum(window_row row, Py_ssize_t window, const double *v, double *sums, Py_ssize_t k)
{
    if (window == 1) {
        for (Py_ssize_t j = 0; j < k; j++)
            sums[j] = v[j];
        return;
    }
    const Py_ssize_t at = (Py_ssize_t)*row.filled;
    double *place = row.values + at * k;
    for (Py_ssize_t j = 0; j < k; j++) {
        row.begun[j] = at ? row.begun[j] + v[j] : v[j];
        sums[j] = place[j] + row.begun[j];
        place[j] = v[j];
    }
    if (at + 1 < window) {
        *row.filled = at + 1;
        return;
    }
    *row.filled = 0;
    for (Py_ssize_t j = 0; j < k; j++) {
        double after = 0.0;
        for (Py_ssize_t i = window - 1; i >= 0; i--) {
            const double value = row.values[i * k + j];
            row.values[i * k + j] = after;
            after = i == window - 1 ? value : after + value;
        }
        row.begun[j] = 0.0;
    }
}

/* Alarms of statistics, NaN where nothing is decided; an alarm of a test that remembers is raised and ended at once. */
INLINE void
raise_alarms(const test_plan *t, const test_row *row, piece *p)
{
    double largest = 0.0;
    for (Py_ssize_t i = 0; i < p->time; i++)
        largest = p->statistic[i] > largest ? p->statistic[i] : largest;
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
judge_norm(const test_plan *t, const test_row *row, piece *p, Py_ssize_t k)
{
    const double *sums = p->q;
    if (t->window > 1) {
        for (Py_ssize_t i = 0; i < p->time; i++)
            moving_sum(row->window, t->window, p->q + i * k, p->sums + i * k, k);
        sums = p->sums;
    }
    for (Py_ssize_t i = 0; i < p->time; i++)
        p->statistic[i] = length_of(sums + i * k, k);
    if (t->window > 1)
        for (Py_ssize_t i = 0; i < p->time; i++)
            p->statistic[i] /= t->root;
    if (!all_set(p->usable, p->time))
        for (Py_ssize_t i = 0; i < p->time; i++)
            p->statistic[i] = p->usable[i] ? p->statistic[i] : NAN;
}

/* ---- tests that remember --------------------------------------------------------------------------------------- */

/* What the past does not foretell of q; whether all of the past that it takes is known. */
static int
unforetold(const test_plan *t, const test_row *row, const double *q, int usable, double *e, double *part)
{
    const Py_ssize_t k = t->k, order = t->order;
    int seen = usable;
    memcpy(e, q, (size_t)k * sizeof(double));
    if (!order)
        return seen;
    for (Py_ssize_t lag = 1; lag <= order; lag++) {
        row_product(row->past + (order - lag) * k, t->coefficients + (lag - 1) * k * k, k, k, part);
        for (Py_ssize_t j = 0; j < k; j++)
            e[j] -= part[j];
        seen &= row->past_usable[order - lag];
    }
    memmove(row->past, row->past + k, (size_t)((order - 1) * k) * sizeof(double));
    memcpy(row->past + (order - 1) * k, q, (size_t)k * sizeof(double));
    memmove(row->past_usable, row->past_usable + 1, (size_t)(order - 1));
    row->past_usable[order - 1] = (flag)usable;
    if (!seen)
        for (Py_ssize_t j = 0; j < k; j++)
            e[j] = 0.0;
    memcpy(part, e, (size_t)k * sizeof(double));
    row_product(part, t->rewhitening, k, k, e);
    return seen;
}

static double
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

static double
page(const test_plan *t, const double *now, const double *e, double *then)
{
    double largest = 0.0;
    for (Py_ssize_t j = 0; j < 2 * t->k; j++) {
        double sum = now[j] + ((j < t->k ? e[j] : -e[j - t->k]) - t->allowance);
        sum = sum > 0.0 ? sum : 0.0;
        then[j] = sum < FULL * t->threshold ? sum : FULL * t->threshold;
        largest = then[j] > largest ? then[j] : largest;
    }
    return largest;
}

static double
crosier(const test_plan *t, const double *now, const double *e, double *then)
{
    for (Py_ssize_t j = 0; j < t->k; j++)
        then[j] = now[j] + e[j];
    const double length = length_of(then, t->k), above = length - t->allowance;
    double left = above > 0.0 ? above : 0.0;
    left = left < FULL * t->threshold ? left : FULL * t->threshold;
    const double part = length > 0 ? left / length : 0.0;
    for (Py_ssize_t j = 0; j < t->k; j++)
        then[j] *= part;
    return left;
}

static double
pignatiello_runger(const test_plan *t, const double *now, const double *e, double *then)
{
    const Py_ssize_t k = t->k;
    const double count = now[k] + 1, full = FULL * t->threshold;
    for (Py_ssize_t j = 0; j < k; j++)
        then[j] = now[j] + e[j];
    const double length = length_of(then, k), above = length - t->allowance * count;
    double left = above > 0.0 ? above : 0.0;
    if (isfinite(full)) {
        const double most = full + t->allowance * count;
        const double part = left > full ? most / (length > 0 ? length : 1.0) : 1.0;
        for (Py_ssize_t j = 0; j < k; j++)
            then[j] *= part;
        left = left < full ? left : full;
    }
    then[k] = count;
    if (!(left > 0))
        for (Py_ssize_t j = 0; j <= k; j++)
            then[j] = 0.0;
    return left;
}

static double
cumulative(const test_plan *t, const test_row *row, const double *e, int seen, double *then)
{
    const Py_ssize_t count = t->sums - 1;
    const double value = t->kind == PAGE      ? page(t, row->sums, e, then)
                         : t->kind == CROSIER ? crosier(t, row->sums, e, then)
                                              : pignatiello_runger(t, row->sums, e, then);
    if (!seen)
        return value;
    int alarmed = row->sums[count] > 0 || value > t->threshold;
    if (alarmed && value <= t->release_level) {
        for (Py_ssize_t j = 0; j < count; j++)
            then[j] = 0.0;
        alarmed = 0;
    }
    memcpy(row->sums, then, (size_t)count * sizeof(double));
    row->sums[count] = alarmed ? 1.0 : 0.0;
    return value;
}

static double
average(const test_plan *t, const test_row *row, const double *e, int seen)
{
    for (Py_ssize_t j = 0; j < t->k; j++)
        if (seen)
            row->sums[j] = t->old_weight * row->sums[j] + t->new_weight * e[j];
    return length_of(row->sums, t->k) / t->deviation;
}

/* Statistics of sums over the last samples that were seen: `sums` of them are kept, of `width` numbers. */
static double
of_recent(const test_plan *t, const test_row *row, const double *now, Py_ssize_t width, double *total)
{
    const Py_ssize_t kept = t->window - 1;
    double best = 0.0;
    for (Py_ssize_t j = 0; j < width; j++)
        total[j] = 0.0;
    for (Py_ssize_t back = 0; back <= kept; back++) {
        const double *sample = back ? row->sums + (kept - back) * width : now;
        double size = 0.0;
        for (Py_ssize_t j = 0; j < width; j++)
            total[j] += sample[j];
        if (t->kind == CHI_SQUARED)
            continue;
        if (t->kind == GLR)
            size = length_of(total, width);
        else
            for (Py_ssize_t j = 0; j < width; j++)
                size = fabs(total[j]) > size ? fabs(total[j]) : size;
        size /= sqrt((double)(back + 1));
        best = back == 0 || size > best ? size : best;
    }
    if (kept) {
        memmove(row->sums, row->sums + width, (size_t)((kept - 1) * width) * sizeof(double));
        memcpy(row->sums + (kept - 1) * width, now, (size_t)width * sizeof(double));
    }
    return t->kind == CHI_SQUARED ? sqrt(total[0]) : best;
}

static double
statistic_of(const test_plan *t, const test_row *row, const double *e, int seen, double *part, double *spare)
{
    if (t->kind <= PIGNATIELLO_RUNGER)
        return cumulative(t, row, e, seen, part);
    if (t->kind == EWMA)
        return average(t, row, e, seen);
    if (!seen)
        return 0.0;
    if (t->kind == CHI_SQUARED) {
        double square = 0.0;
        for (Py_ssize_t j = 0; j < t->k; j++)
            square += e[j] * e[j];
        return of_recent(t, row, &square, 1, part);
    }
    if (t->kind == GLR)
        return of_recent(t, row, e, t->k, part);
    row_product(e, t->along, t->k, t->directions, spare);
    return of_recent(t, row, spare, t->directions, part);
}

static void
judge_stream(const test_plan *t, const test_row *row, piece *p, double *e, double *part, double *spare)
{
    for (Py_ssize_t i = 0; i < p->time; i++) {
        const int seen = unforetold(t, row, p->q + i * t->k, p->usable[i], e, part);
        if (t->knots_of_each)
            for (Py_ssize_t j = 0; j < t->k; j++)
                e[j] = score_of(t->knots + j * t->knots_of_each, t->scores, t->knots_of_each, e[j]);
        const double statistic = statistic_of(t, row, e, seen, part, spare);
        p->statistic[i] = seen ? statistic : NAN;
        p->usable[i] = (flag)seen;
    }
}

/* ---- isolation by direction ------------------------------------------------------------------------------------ */

/* How well each signature explains one sum of residuals; NaN where nothing can be said. */
INLINE void
score_sample(const isolation_plan *n, const double *sums, int usable, double *part, double *scores, Py_ssize_t k)
{
    const double size = length_of(sums, k);
    if (!(usable && size > 0)) {
        for (Py_ssize_t g = 0; g < n->groups; g++)
            scores[g] = NAN;
        return;
    }
    double *along = n->are_lines ? scores : part; /* of lines the part is all there is */
    for (Py_ssize_t c = 0; c < n->columns; c++)
        along[c] = 0.0;
    for (Py_ssize_t j = 0; j < k; j++)
        for (Py_ssize_t c = 0; c < n->columns; c++)
            along[c] += sums[j] * n->bases[j * n->columns + c];
    if (along == scores) {
        for (Py_ssize_t g = 0; g < n->groups; g++) {
            const double score = sqrt(scores[g] * scores[g]) / size;
            scores[g] = score < 1.0 ? score : 1.0;
        }
        return;
    }
    for (Py_ssize_t g = 0; g < n->groups; along += n->dimensions[g++]) {
        const double score = length_of(along, (Py_ssize_t)n->dimensions[g]) / size;
        scores[g] = score < 1.0 ? score : 1.0;
    }
}

INLINE void
name_by_direction(const isolation_plan *n, window_row row, const piece *p, double *part, Py_ssize_t k)
{
    for (Py_ssize_t i = 0; i < p->time; i++)
        moving_sum(row, n->window, p->q + i * k, p->sums + i * k, k);
    if (p->scores != NULL)
        for (Py_ssize_t i = 0; i < p->time; i++)
            score_sample(n, p->sums + i * k, p->usable[i], part, p->scores + i * n->groups, k);
}

#endif
