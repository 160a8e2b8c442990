/* Tests of parts of the residual one by one, members of a bank or groups of residuals, and the codes that members spell.
 *
 * As residua.decide.member_thresholds and residua.decide.structured have them, with the same bits.
 */
#ifndef RESIDUA_MEMBERS_H
#define RESIDUA_MEMBERS_H

#include "_judging.h"

/* What the alarms of parts, and the reading of codes, remember of one plant: a number for each part. */
typedef struct {
    whole *up, *down, *since;
    flag *alarm, *fired;
    window_row counts;
} part_row;

/* What is known of the parts in the samples of a piece, a row for each. */
typedef struct {
    double *statistics;
    flag *fired, *code;
    double *ones, *counts; /* room: members in alarm as numbers, and how many of them there are in the window */
    double *columns;       /* room: residuals, one whitened residual, and a square of each part, for all samples */
    whole before;          /* samples before the piece */
} part_piece;

/* Whitened residuals of one sample, each of the few residuals that it takes: no other has a weight. */
INLINE void
whitened_parts(const test_plan *t, const double *r, double *q, double *centred)
{
    const Py_ssize_t k = t->k;
    for (Py_ssize_t i = 0; i < t->nr; i++)
        centred[i] = r[i] - t->center[i];
    for (Py_ssize_t j = 0; j < k; j++)
        q[j] = 0.0;
    for (Py_ssize_t l = 0; l < t->terms; l++)
        for (Py_ssize_t j = 0; j < k; j++)
            q[j] += centred[t->from[l * k + j]] * t->weights[l * k + j];
}

/* Whitened residuals of a piece; 0 and not usable where one would overflow a sum. */
INLINE void
whiten_parts(const test_plan *t, const piece *p, double *centred)
{
    const Py_ssize_t nr = t->nr, k = t->k;
    for (Py_ssize_t i = 0; i < p->time; i++) {
        double *q = p->q + i * k;
        if (p->usable[i])
            whitened_parts(t, p->r + i * nr, q, centred);
        if (p->usable[i] && all_within(q, k, LARGEST_WHITENED))
            continue;
        p->usable[i] = 0;
        for (Py_ssize_t j = 0; j < k; j++)
            q[j] = 0.0;
    }
}

/* Whitened residuals of a piece, and the squares of each part, column by column: all samples of one at once. 0 where a
 * sample is not usable, or might not be. `keeps`: whether the whitened residuals themselves are asked for. */
INLINE int
squares_by_column(const test_plan *t, const piece *p, part_piece *m, int keeps)
{
    const Py_ssize_t time = p->time, k = t->k, nr = t->nr, parts = t->parts;
    double *const white = m->columns + nr * time, *const squares = white + time;
    if (!all_set(p->usable, time))
        return 0;
    for (Py_ssize_t c = 0; c < nr; c++)
        for (Py_ssize_t i = 0; i < time; i++)
            m->columns[c * time + i] = p->r[i * nr + c] - t->center[c];
    clear_doubles(squares, parts * time);
    for (Py_ssize_t part = 0; part < parts; part++) {
        double *restrict square = squares + part * time;
        for (Py_ssize_t j = (Py_ssize_t)t->begins[part]; j < t->begins[part + 1]; j++) {
            clear_doubles(white, time);
            for (Py_ssize_t l = 0; l < t->terms; l++) {
                const double *restrict from = m->columns + t->from[l * k + j] * time;
                const double weight = t->weights[l * k + j];
                for (Py_ssize_t i = 0; i < time; i++)
                    white[i] += from[i] * weight;
            }
            for (Py_ssize_t i = 0; i < time; i++)
                square[i] += white[i] * white[i];
            if (keeps)
                for (Py_ssize_t i = 0; i < time; i++)
                    p->q[i * k + j] = white[i];
        }
    }
    return all_within(squares, parts * time, LARGEST_SQUARES);
}

/* The norms of these squares, and of each sample the largest in units of its threshold. */
INLINE void
norms_by_column(const test_plan *t, piece *p, part_piece *m)
{
    const Py_ssize_t time = p->time, parts = t->parts;
    double *const squares = m->columns + (t->nr + 1) * time, *restrict const largest = p->statistic;
    roots(squares, parts * time);
    for (Py_ssize_t part = 0; part < parts; part++) {
        const double *restrict norm = squares + part * time;
        const double limit = t->limits[part];
        if (part == 0)
            for (Py_ssize_t i = 0; i < time; i++)
                largest[i] = norm[i] / limit;
        else
            for (Py_ssize_t i = 0; i < time; i++) {
                const double ratio = norm[i] / limit;
                largest[i] = ratio > largest[i] ? ratio : largest[i];
            }
        for (Py_ssize_t i = 0; i < time; i++)
            m->statistics[i * parts + part] = norm[i];
    }
}

/* The norm of each part, over the window, and of these the largest in units of its threshold. */
INLINE void
norms_of_parts(const test_plan *t, window_row window, piece *p, part_piece *m)
{
    const Py_ssize_t k = t->k, parts = t->parts;
    const double *sums = p->q;
    if (t->window > 1) {
        sums_of_judged(window, t->window, p, k);
        sums = p->sums;
    }
    for (Py_ssize_t i = 0; i < p->time; i++)
        for (Py_ssize_t j = 0; j < parts; j++)
            m->statistics[i * parts + j] = square_of(sums + i * k + t->begins[j], t->begins[j + 1] - t->begins[j]);
    roots(m->statistics, p->time * parts);
    if (t->window > 1)
        for (Py_ssize_t i = 0; i < p->time * parts; i++)
            m->statistics[i] /= t->root;
    for (Py_ssize_t i = 0; i < p->time; i++) {
        const double *one = m->statistics + i * parts;
        double largest = one[0] / t->limits[0];
        for (Py_ssize_t j = 1; j < parts; j++) {
            const double ratio = one[j] / t->limits[j];
            largest = ratio > largest ? ratio : largest;
        }
        p->statistic[i] = largest;
    }
    if (all_set(p->usable, p->time))
        return;
    for (Py_ssize_t i = 0; i < p->time; i++)
        if (!p->usable[i]) {
            p->statistic[i] = NAN;
            for (Py_ssize_t j = 0; j < parts; j++)
                m->statistics[i * parts + j] = NAN;
        }
}

/* Alarms of each part, and of all. */
INLINE void
alarms_of_parts(const test_plan *t, const part_row *row, piece *p, part_piece *m)
{
    const Py_ssize_t parts = t->parts;
    int stands = 0;
    for (Py_ssize_t j = 0; j < parts; j++)
        stands |= row->up[j] != 0 || row->alarm[j];
    p->is_quiet = !stands && largest_of(p->statistic, p->time) < 1.0 && all_set(p->usable, p->time);
    if (p->is_quiet) { /* no statistic is over: its ratio would be 1 at least */
        memset(m->fired, 0, (size_t)(p->time * parts));
        for (Py_ssize_t j = 0; j < parts; j++)
            row->down[j] += p->time;
        return;
    }
    for (Py_ssize_t i = 0; i < p->time; i++) {
        const double *statistic = m->statistics + i * parts;
        flag *fired = m->fired + i * parts, any_over = 0, any = 0;
        whole longest = 0;
        for (Py_ssize_t j = 0; j < parts; j++) {
            if (p->usable[i]) {
                const int over = statistic[j] > t->limits[j];
                row->up[j] = over ? row->up[j] + 1 : 0;
                row->down[j] = over ? 0 : row->down[j] + 1;
                if (over ? row->up[j] >= t->persistence : row->down[j] >= t->release)
                    row->alarm[j] = (flag)over;
                any_over |= (flag)over;
            }
            fired[j] = row->alarm[j];
            any |= fired[j];
            longest = fired[j] && row->up[j] > longest ? row->up[j] : longest;
        }
        p->over[i] = any_over;
        p->alarm[i] = any;
        p->up[i] = longest;
    }
}

/* The longest mean of each part, and of these the largest in units of its threshold. */
INLINE void
means_of_parts(const test_plan *t, const test_row *row, piece *p, part_piece *m, double *room)
{
    const Py_ssize_t k = t->k, parts = t->parts;
    double *const e = room, *const part = room + k;
    for (Py_ssize_t i = 0; i < p->time; i++) {
        const double *one = p->q + i * k;
        double *statistic = m->statistics + i * parts;
        if (t->order) {
            p->usable[i] = (flag)unforetold(t, row, one, p->usable[i], e, part, k);
            one = e;
        }
        double largest = 0.0;
        for (Py_ssize_t j = 0; j < parts; j++) {
            const Py_ssize_t begin = (Py_ssize_t)t->begins[j], size = (Py_ssize_t)t->begins[j + 1] - begin;
            statistic[j] = p->usable[i] ? sqrt(longest_mean(t, row->sums, one, j, begin, size, k)) : NAN;
            const double ratio = statistic[j] / t->limits[j];
            largest = ratio > largest ? ratio : largest;
        }
        p->statistic[i] = p->usable[i] ? largest : NAN;
    }
}

/* Alarms of the means of each part, raised and ended at once, and of all. */
INLINE void
alarms_of_means(const test_plan *t, const part_row *row, piece *p, part_piece *m)
{
    const Py_ssize_t parts = t->parts;
    for (Py_ssize_t i = 0; i < p->time; i++) {
        const double *statistic = m->statistics + i * parts;
        flag *fired = m->fired + i * parts, any_over = 0, any = 0;
        for (Py_ssize_t j = 0; j < parts; j++) {
            if (p->usable[i]) {
                const int over = statistic[j] > t->limits[j];
                if (over || statistic[j] <= t->releases[j])
                    row->alarm[j] = (flag)over;
                any_over |= (flag)over;
            }
            fired[j] = row->alarm[j];
            any |= fired[j];
        }
        if (p->usable[i])
            row->up[0] = any_over ? row->up[0] + 1 : 0;
        p->over[i] = any_over;
        p->alarm[i] = any;
        p->up[i] = row->up[0];
    }
}

/* The residual in units in which its direction is judged, zero where it is not usable. */
INLINE void
joint_residuals(const test_plan *t, const piece *p, double *centred)
{
    for (Py_ssize_t i = 0; i < p->time; i++) {
        for (Py_ssize_t j = 0; j < t->nr; j++)
            centred[j] = p->usable[i] ? p->r[i * t->nr + j] - t->center[j] : 0.0;
        row_product(centred, t->joint, t->nr, t->k, p->q + i * t->k);
    }
}

/* ---- codes ----------------------------------------------------------------------------------------------------- */

/* Since which sample each member fires, in the alarm that stands; 0 for one of which that is not known. */
INLINE void
follow_members(const part_row *row, const flag *fired, whole number, Py_ssize_t members)
{
    flag any = 0;
    for (Py_ssize_t j = 0; j < members; j++)
        any |= fired[j];
    for (Py_ssize_t j = 0; j < members; j++) {
        if (!any)
            row->since[j] = 0;
        else if (row->since[j] == 0 && fired[j] && !row->fired[j])
            row->since[j] = number;
        row->fired[j] = fired[j];
    }
}

/* How many members agree with the code of each group; NaN where no code is read. */
INLINE void
agreements(const isolation_plan *n, const flag *code, int usable, double *scores)
{
    const Py_ssize_t members = n->k;
    flag any = 0;
    for (Py_ssize_t j = 0; j < members; j++)
        any |= code[j];
    for (Py_ssize_t g = 0; g < n->groups; g++) {
        const flag *own = n->codes + g * members;
        Py_ssize_t agree = 0;
        for (Py_ssize_t j = 0; j < members; j++)
            agree += code[j] == own[j];
        scores[g] = usable && any ? (double)agree / (double)members : NAN;
    }
}

/* Whether a window holds nothing but zeros; what is added then are zeros. */
INLINE int
is_empty(window_row row, Py_ssize_t window, Py_ssize_t k)
{
    return window > 1 && all_within(row.values, window * k, 0.0) && all_within(row.begun, k, 0.0);
}

/* Which members count as fired over the window, and how well that agrees with each code. */
static void
read_codes(const isolation_plan *n, const part_row *row, const piece *p, part_piece *m)
{
    const Py_ssize_t members = n->k, time = p->time;
    const int may_skip = p->is_quiet && time >= 16; /* else it takes longer to look */
    if (may_skip && is_empty(row->counts, n->window, members))
        *row->counts.filled = (*row->counts.filled + time) % n->window;
    else {
        for (Py_ssize_t i = 0; i < time; i++)
            for (Py_ssize_t j = 0; j < members; j++)
                m->ones[i * members + j] = p->usable[i] && m->fired[i * members + j] ? 1.0 : 0.0;
        moving_sums(row->counts, n->window, m->ones, m->counts, time, members);
    }
    if (p->is_quiet) {
        for (Py_ssize_t j = 0; j < members; j++)
            row->since[j] = row->fired[j] = 0;
        memset(m->code, 0, (size_t)(time * members));
        for (Py_ssize_t i = 0; p->scores != NULL && i < time * n->groups; i++)
            p->scores[i] = NAN;
        return;
    }
    for (Py_ssize_t i = 0; i < p->time; i++) {
        const double *count = m->counts + i * members;
        const flag *fired = m->fired + i * members;
        flag *code = m->code + i * members;
        double largest = 0.0;
        for (Py_ssize_t j = 0; j < members; j++)
            largest = count[j] > largest ? count[j] : largest;
        for (Py_ssize_t j = 0; j < members; j++)
            code[j] = n->is_at_once ? fired[j]
                                    : (flag)(p->alarm[i] && count[j] > 0.0 && count[j] >= n->share * largest);
        if (p->scores != NULL)
            agreements(n, code, p->usable[i], p->scores + i * n->groups);
        follow_members(row, fired, m->before + i + 1, members);
    }
}

#endif
