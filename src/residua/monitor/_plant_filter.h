/* What the fused loop runs, and its filter on a piece of one plant: values held, starts, restarts, overflows.
 *
 * As residua.monitor.filtering and residua.monitor.one_plant have it, with the same bits.
 */
#ifndef RESIDUA_PLANT_FILTER_H
#define RESIDUA_PLANT_FILTER_H

#define RESIDUA_JUDGES
#include <limits.h>

#include "../linear/systems/_filter.h"
#include "../decide/_members.h"
#include "_partial_gain.h"

#define LARGEST 1e150 /* as in residua.monitor.one_plant */

#include "_four_samples.h"

#define PIECE 1024
#define LONG_PIECE 8448 /* of a test that takes many samples at once, from places that are not 4 kB apart */
#define FAR 1e15      /* limits beyond are no signal's: as a rule one bound of all values tells that they are within */

/* ---- what runs, and its arrays ---------------------------------------------------------------------------------- */

enum {
    A_, B_, C_, D_, START, OFFSET, LOW, HIGH, ROWS, CORRECTION, RATIOS, CENTER, WHITENING, COEFFICIENTS, REWHITENING,
    KNOTS, SCORES, ALONG, BASES, DIMENSIONS, SIZES, LIMITS, JOINT, CODE_TABLE, MEAN_NUMBERS,
    PARTIAL_NUMBERS, PLAN_ARRAYS
};
enum {
    X, HELD, GAP, RUNNING, AGE, RESETS, BROKEN, STARTING, START_SUMS, MOVED, APART, SPREAD, COUNT, TEST_VALUES,
    TEST_BEGUN, TEST_FILLED, PAST, PAST_USABLE, SUMS, UP, DOWN, ALARM, VALUES, BEGUN, FILLED, SINCE, FIRED, LAST_FLAGS,
    LAST_STATISTIC, LAST_RESIDUALS, LAST_UP, LAST_SCORES, LAST_CODE,
    STATE_ARRAYS
};
enum {
    OUT_RESIDUALS, OUT_MISSING, OUT_ASIDE, OUT_USABLE, OUT_STATISTIC, OUT_EXCEEDED, OUT_ALARM, OUT_UP, OUT_WHITENED,
    OUT_SCORES, OUT_READY, OUT_PARTS, OUT_FIRED, OUT_CODE, OUTPUTS
};
enum {
    N, N_U, N_Y, N_R, SETTLE, MAX_HOLD, FIRST, N_RATIOS, PARTIAL, TEST_KIND, K, WINDOW, PERSISTENCE, RELEASE, ORDER,
    N_KNOTS, N_SUMS, N_ALONG, GROUPS, ISOLATION_WINDOW, COLUMNS, N_PARTS, MEMBERS, AT_ONCE, PLANT_INPUTS,
    N_SCALES,
    INTEGERS
};
enum { THRESHOLD, RELEASE_LEVEL, ALLOWANCE, OLD_WEIGHT, NEW_WEIGHT, DEVIATION, SHARE, MOVED_FROM, CLEAR, NUMBERS };

#define NOTES 64     /* plants in a thread whose restarts and starts are noted before room is made for those of all */
#define NOTE_HEAD 5  /* numbers of a note before the sums of a start: row, restarts of two kinds, whether it starts, moved */
typedef int32_t counter; /* stops at its largest number, as residua.decide.persistence says */

/* What is zero for most plants: where it lies of one, in its columns if there is room, else in a note. */
typedef struct {
    double *start_sums, *moved;
    whole *resets, *broken;
} seldom_row;

typedef struct {
    source in;                                            /* deviations of a piece: where they lie, or in v */
    double *v, *r, *own_r, *q, *sums, *statistic, *e, *history; /* of a piece; r may be an output */
    whole *up;
    double *x, *starts, *small; /* of states and a spare one; of states that filters start with; of one sample */
    flag *usable, *over, *alarm;
    part_piece parts; /* room for what is not an output */
    double *columns;  /* room: sums by which directions are judged, and three more numbers, for all samples */
    whole count;      /* samples of the plant before the piece */
    job filter;
    int is_missing; /* the last sample of the piece */
    int is_short;   /* whether nothing but the squares of a piece is asked for */
    int is_judged;  /* whether q and the squares of a piece are there already, in `statistic` */
    int is_within;  /* and whether none of these is over the limit */
    Py_ssize_t apart, apart_if_columns; /* whether q is there in columns, so many numbers apart; else 0 */
    double *columns_of_q;
    int may_be_raw, is_raw; /* whether residuals are not judged meanwhile, as what judges them whitens them; and were not */
    int is_deferred; /* whether it is the filter that finds out whether all signals are values */
    gain_store gains;
    double *stream;    /* the sums of a test that remembers, and whether an alarm stands */
    whole *runs;       /* of the counters of parts, and what they were before a piece */
    double *sample;    /* with values held where they are missing */
    seldom_row seldom; /* of the plant that is run */
    double *notes;     /* of plants for which there are no columns: as Python takes them in */
    Py_ssize_t n_notes;
    int wants_gains; /* whether a plant was left for want of what a Kalman filter with missing values needs */
} scratch;

typedef struct {
    char *base;
    Py_ssize_t plant, time; /* bytes from one to the next */
} output;

typedef struct {
    const char *u, *y;
    Py_ssize_t u_strides[3], y_strides[3], time;
    int is_dense; /* whether the channels of a sample lie side by side */
    int is_used;  /* whether outputs hold something, which is cleared first */
    output out[OUTPUTS];
    output joined; /* where to put u and y side by side, as they are */
} block;

typedef struct {
    Py_buffer views[OUTPUTS + 7];
    int held;
} views;

typedef struct {
    PyObject_HEAD
    Py_ssize_t n, m, n_u, n_y, nr, n_ratios;
    Py_ssize_t held; /* channels whose last values are held */
    double moved_from; /* how far a start moves a residual at least for it to be remembered */
    int has_starts;  /* whether there is room for the starts of all plants */
    int lacks_room;  /* whether there is none for something that is seldom */
    whole settle, max_hold, first;
    int partial, path;
    int has_gains; /* whether there is what a Kalman filter with missing values needs; else such a plant is left */
    partial_plan some;
    test_plan test;
    isolation_plan naming;
    job filter;
    const double *judge; /* centre and whitening of at most four residuals, padded; NULL of more */
    section *sections; /* of the filter, if it has several; what they are packed in */
    double *sections_room;
    void *parts_room; /* of what the plan of a test of parts points at */
    double *room; /* of the packed matrices, and: */
    job starter; /* from a sample to the state that a filter starts with: outputs of one whose only state stays zero */
    double *zeros;
    Py_ssize_t span; /* samples of a plant that are judged at once, at most */
    double *tile; /* of four samples: offsets, lowest values, highest values; of u and y, of u, of y */
    int in_quads, in_columns; /* whether four samples are judged at once; whether their whitened residuals lie in columns */
    double most_raw;          /* of the sizes of residuals together that are whitened where they are read; or 0 */
    double limit;             /* of squares so that nothing is over the threshold */
    double nearest;           /* as `nearest_limit`, of all signals; 0 where they have an offset */
    int has_offset, sums_squares; /* whether residuals are judged by the sum of the squares of each sample, and nothing else */
    Py_ssize_t plants;
    Py_buffer plan[PLAN_ARRAYS], state[STATE_ARRAYS];
    char *base[STATE_ARRAYS]; /* of the state: where the first row lies, and how far apart rows are */
    Py_ssize_t stride[STATE_ARRAYS];
    char *records; /* where what every sample touches lies side by side: the first record, and how many bytes; else 0 */
    Py_ssize_t record_size, offset[STATE_ARRAYS]; /* from the beginning of a record */
    char has_plan[PLAN_ARRAYS], has_state[STATE_ARRAYS];
    block one; /* of a step: its outputs */
    views one_views;
    scratch one_scratch;
    void *one_room;
} Runner;

#define PLACE(self, which, row) ((self)->base[which] + (row) * (self)->stride[which])
#define F8(self, which, row) ((double *)PLACE(self, which, row))
#define I8(self, which, row) ((whole *)PLACE(self, which, row))
#define I4(self, which, row) ((counter *)PLACE(self, which, row))
#define B1(self, which, row) ((flag *)PLACE(self, which, row))
#define PLAN(self, which) ((const double *)(self)->plan[which].buf)

static double *
out_f8(const block *b, int which, Py_ssize_t plant, Py_ssize_t k)
{
    const output *o = &b->out[which];
    return o->base == NULL ? NULL : (double *)(o->base + plant * o->plant + k * o->time);
}

static flag *
out_b1(const block *b, int which, Py_ssize_t plant, Py_ssize_t k)
{
    return (flag *)out_f8(b, which, plant, k);
}

INLINE counter
stopped(whole count)
{
    return count < INT32_MAX ? (counter)count : INT32_MAX;
}

/* ---- what is seldom ---------------------------------------------------------------------------------------------- */

/* Begin with a plant: point at its columns, or at a note; 0 if there is no room for another one. */
static int
open_seldom(const Runner *self, Py_ssize_t row, scratch *s)
{
    const Py_ssize_t size = NOTE_HEAD + self->n;
    double *note = NULL;
    if (self->lacks_room) {
        if (s->n_notes == NOTES)
            return 0;
        note = s->notes + s->n_notes * size;
        memset(note, 0, (size_t)size * sizeof(double));
        *(whole *)note = row;
    }
    s->seldom = (seldom_row){
        self->has_state[START_SUMS] || note == NULL ? F8(self, START_SUMS, row) : note + NOTE_HEAD,
        self->has_state[MOVED] || note == NULL ? F8(self, MOVED, row) : note + 4,
        self->has_state[RESETS] || note == NULL ? I8(self, RESETS, row) : (whole *)(note + 1),
        self->has_state[BROKEN] || note == NULL ? I8(self, BROKEN, row) : (whole *)(note + 2)};
    return 1;
}

/* Keep the note of a plant of which there is something to tell. */
static void
close_seldom(const Runner *self, Py_ssize_t row, scratch *s)
{
    if (!self->lacks_room)
        return;
    double *const note = s->notes + s->n_notes * (NOTE_HEAD + self->n);
    const whole *const counts = (const whole *)note;
    ((whole *)note)[3] = !self->has_state[START_SUMS] && *B1(self, STARTING, row);
    if (counts[1] || counts[2] || counts[3] || note[4] != 0.0)
        s->n_notes++;
}

/* ---- the filter -------------------------------------------------------------------------------------------------- */

/* Take the offset from samples in a row, where `to` is not NULL; whether all are between the limits. The tile has four
 * samples of each. */
INLINE int
deviations_plain(const double *from, double *to, Py_ssize_t total, const double *tile, Py_ssize_t period)
{
    int all = 1;
    for (Py_ssize_t left = total; left > 0; left -= period, from += period)
        for (Py_ssize_t i = 0; i < (left < period ? left : period); i++) {
            const double value = to == NULL ? from[i] : from[i] - tile[i];
            if (to != NULL)
                *to++ = value;
            all &= (value >= tile[period + i]) & (value <= tile[2 * period + i]);
        }
    return all;
}

#if defined(HAVE_VECTORS)
#define DEFINE_DEVIATIONS(NAME, TARGET, L, CENTRED)                                                                   \
    TARGET static int NAME(const double *from, double *to, Py_ssize_t total, const double *tile, Py_ssize_t period)   \
    {                                                                                                                 \
        flags##L within = ((flags##L){0} == (flags##L){0});                                                           \
        const double *low = tile + period, *high = low + period;                                                      \
        Py_ssize_t left = total;                                                                                      \
        for (; left >= period; left -= period, from += period) {                                                      \
            for (Py_ssize_t i = 0; i < period; i += L) {                                                              \
                lanes##L value = *(const lanes##L *)(from + i);                                                       \
                if (CENTRED) {                                                                                        \
                    value -= *(const lanes##L *)(tile + i);                                                           \
                    *(lanes##L *)(to + i) = value;                                                                    \
                }                                                                                                     \
                within &= (flags##L)(value >= *(const lanes##L *)(low + i))                                           \
                          & (flags##L)(value <= *(const lanes##L *)(high + i));                                       \
            }                                                                                                         \
            if (CENTRED)                                                                                              \
                to += period;                                                                                         \
        }                                                                                                             \
        int all = deviations_plain(from, CENTRED ? to : NULL, left, tile, period);                                    \
        for (int l = 0; l < L; l++)                                                                                   \
            all &= within[l] != 0;                                                                                    \
        return all;                                                                                                   \
    }
DEFINE_DEVIATIONS(deviations_baseline, , 2, 1)
DEFINE_DEVIATIONS(within_baseline, , 2, 0)
#if defined(HAVE_AVX2)
DEFINE_DEVIATIONS(deviations_avx2, AVX2, 4, 1)
DEFINE_DEVIATIONS(within_avx2, AVX2, 4, 0)
#endif

/* Four vectors at once, as long as there are so many: their sizes are added to `sum`, without an offset if CENTRED. */
#define ADD_SIZES(COUNT, L, CENTRED)                                                                                  \
    for (; i + (COUNT) * L <= period; i += (COUNT) * L)                                                               \
        _Pragma("GCC unroll 4") for (int l = 0; l < (COUNT); l++)                                                     \
        {                                                                                                             \
            lanes##L value = ((const lanes##L *)(from + i))[l];                                                       \
            if (CENTRED) {                                                                                            \
                value -= ((const lanes##L *)(tile + i))[l];                                                           \
                ((lanes##L *)(to + i))[l] = value;                                                                    \
            }                                                                                                         \
            sum[l] += (lanes##L)((flags##L)value & sign);                                                             \
        }

/* The sum of the sizes of samples in a row, from which the offset is taken if CENTRED; four samples of it are in the
 * tile. No value is larger than the sum, and one that is not finite makes it so. */
#define DEFINE_SIZES(NAME, TARGET, L, CENTRED)                                                                        \
    TARGET static double NAME(const double *from, double *to, Py_ssize_t total, const double *tile, Py_ssize_t columns)\
    {                                                                                                                 \
        lanes##L sum[4] = {{0.0}};                                                                                    \
        const flags##L sign = (flags##L){0} + LLONG_MAX;                                                              \
        double all = 0.0;                                                                                             \
        for (Py_ssize_t left = total; left > 0; left -= columns) {                                                    \
            const Py_ssize_t period = left < columns ? left : columns;                                                \
            Py_ssize_t i = 0;                                                                                         \
            ADD_SIZES(4, L, CENTRED)                                                                                  \
            ADD_SIZES(1, L, CENTRED)                                                                                  \
            for (; i < period; i++) {                                                                                 \
                const double value = CENTRED ? from[i] - tile[i] : from[i];                                           \
                if (CENTRED)                                                                                          \
                    to[i] = value;                                                                                    \
                all += fabs(value);                                                                                   \
            }                                                                                                         \
            from += period;                                                                                           \
            if (CENTRED)                                                                                              \
                to += period;                                                                                         \
        }                                                                                                             \
        for (int j = 0; j < 4; j++)                                                                                   \
            for (int l = 0; l < L; l++)                                                                               \
                all += sum[j][l];                                                                                     \
        return all;                                                                                                   \
    }

DEFINE_SIZES(centred_baseline, , 2, 1)
DEFINE_SIZES(sizes_baseline, , 2, 0)
#if defined(HAVE_AVX2)
DEFINE_SIZES(centred_avx2, AVX2, 4, 1)
DEFINE_SIZES(sizes_avx2, AVX2, 4, 0)
#endif
#endif

/* How far any of the limits of a tile is from zero, or 0 if it is so near that values are to be compared with each. */
INLINE double
nearest_limit(const double *tile, Py_ssize_t period)
{
    double nearest = DBL_MAX;
    for (Py_ssize_t i = 0; i < period; i++) {
        nearest = -tile[period + i] < nearest ? -tile[period + i] : nearest;
        nearest = tile[2 * period + i] < nearest ? tile[2 * period + i] : nearest;
    }
    return nearest >= FAR ? nearest : 0.0;
}

static int
deviations(const Runner *self, const double *from, double *to, Py_ssize_t rows, const double *tile, Py_ssize_t columns)
{
    if (columns == 0) /* loops go on by so many */
        return 1;
#if defined(HAVE_VECTORS)
    const double nearest = rows < 8 ? 0.0 : nearest_limit(tile, 4 * columns);
    if (nearest > 0.0 && self->path != PATH_PLAIN) {
        double (*sizes)(const double *, double *, Py_ssize_t, const double *, Py_ssize_t);
        sizes = to == NULL ? sizes_baseline : centred_baseline;
#if defined(HAVE_AVX2)
        if (self->path == PATH_AVX2)
            sizes = to == NULL ? sizes_avx2 : centred_avx2;
#endif
        const Py_ssize_t period = to == NULL ? rows * columns : 4 * columns;
        if (sizes(from, to, rows * columns, tile, period) <= nearest)
            return 1;
        if (to != NULL) /* deviations they are by now */
            from = to;
        to = NULL;
    }
#endif
#if defined(HAVE_AVX2)
    if (self->path == PATH_AVX2)
        return (to == NULL ? within_avx2 : deviations_avx2)(from, to, rows * columns, tile, 4 * columns);
#endif
#if defined(HAVE_VECTORS)
    if (self->path == PATH_BASELINE)
        return (to == NULL ? within_baseline : deviations_baseline)(from, to, rows * columns, tile, 4 * columns);
#endif
    return deviations_plain(from, to, rows * columns, tile, 4 * columns);
}

/* A few numbers, without a call. */
INLINE double *
copy_few(double *to, const char *from, Py_ssize_t count)
{
    for (; count >= 4; count -= 4, to += 4, from += 32)
        memcpy(to, from, 32);
    if (count & 2) {
        memcpy(to, from, 16);
        to += 2;
        from += 16;
    }
    if (count & 1)
        memcpy(to++, from, 8);
    return to;
}

INLINE void
copy_doubles(void *to, const void *from, Py_ssize_t count)
{
    if (count <= 16)
        copy_few(to, from, count);
    else
        memcpy(to, from, (size_t)count * sizeof(double));
}

INLINE void
copy_flags(flag *to, const flag *from, Py_ssize_t count)
{
    if (count == 1)
        *to = *from;
    else
        memcpy(to, from, (size_t)count);
}

INLINE int
is_double(const char *at, Py_ssize_t step)
{
    return ((uintptr_t)at | (uintptr_t)step) % sizeof(double) == 0;
}

/* Deviations of rows one stride after the other; whether all are values. They stay where they lie if they can, and the
 * filter may look at them then. */
static int
gather(const Runner *self, const block *b, const char *u, const char *y, Py_ssize_t u_step, Py_ssize_t y_step,
       Py_ssize_t rows, int may_defer, scratch *s)
{
    const Py_ssize_t n_u = self->n_u, n_y = self->n_y, m = self->m, size = sizeof(double);
    const double *const u_tile = self->tile + 12 * m, *const y_tile = u_tile + 12 * n_u;
    const int is_there = b->is_dense && is_double(u, u_step) && is_double(y, y_step);
    const int u_packed = rows == 1 || u_step == n_u * size, y_packed = rows == 1 || y_step == n_y * size;
    double *v = s->v;
    s->is_deferred = may_defer && is_there && self->nearest > 0.0;
    if (is_there && n_u && n_y && u_packed && y_packed) {
        double *const w = v + rows * n_u;
        if (s->is_deferred) {
            s->in = (source){(const double *)u, (const double *)y, n_u, n_u, n_y};
            return 1;
        }
        int all = deviations(self, (const double *)u, self->has_offset ? v : NULL, rows, u_tile, n_u);
        all &= deviations(self, (const double *)y, self->has_offset ? w : NULL, rows, y_tile, n_y);
        if (self->has_offset)
            s->in = (source){v, w, n_u, n_u, n_y};
        else
            s->in = (source){(const double *)u, (const double *)y, n_u, n_u, n_y};
        return all;
    }
    const char *const from = n_u ? u : y;
    const Py_ssize_t step = n_u ? u_step : y_step;
    const int is_joint = !n_u || !n_y || (y == u + n_u * size && (rows == 1 || u_step == y_step));
    if (is_there && is_joint && (rows == 1 || step == m * size)) {
        s->in = one_array(self->has_offset ? v : (const double *)from, m);
        if (s->is_deferred)
            return 1;
        return deviations(self, (const double *)from, self->has_offset ? v : NULL, rows, self->tile, m);
    }
    s->is_deferred = 0;
    if (b->is_dense)
        for (Py_ssize_t i = 0; i < rows; i++, u += u_step, y += y_step)
            v = copy_few(copy_few(v, u, n_u), y, n_y);
    else
        for (Py_ssize_t i = 0; i < rows; i++, u += u_step, y += y_step) {
            for (Py_ssize_t j = 0; j < n_u; j++)
                *v++ = *(const double *)(u + j * b->u_strides[2]);
            for (Py_ssize_t j = 0; j < n_y; j++)
                *v++ = *(const double *)(y + j * b->y_strides[2]);
        }
    s->in = one_array(s->v, m);
    return deviations(self, s->v, s->v, rows, self->tile, m);
}

/* One of the deviations. */
INLINE double
deviation(const source *in, Py_ssize_t row, Py_ssize_t column)
{
    return column < in->columns ? in->first[row * in->first_step + column]
                                : in->second[row * in->second_step + column - in->columns];
}

/* The first `some` of them. */
INLINE void
copy_sample(double *to, const source *in, Py_ssize_t row, Py_ssize_t some)
{
    copy_doubles(to, in->first + row * in->first_step, some < in->columns ? some : in->columns);
    if (some > in->columns)
        copy_doubles(to + in->columns, in->second + row * in->second_step, some - in->columns);
}

static int
filter_some(const Runner *self, scratch *s, double *x, source v, double *r, Py_ssize_t time, const double *judge)
{
    s->filter.time = time;
    s->filter.plants = 1;
    s->filter.x = s->filter.x_next = x;
    s->filter.v = v;
    s->filter.r = r;
    s->filter.judge = judge;
    return execute(&s->filter, self->path);
}

static int
is_finite(const double *values, Py_ssize_t count)
{
    int finite = 1;
    for (Py_ssize_t j = 0; j < count; j++)
        finite &= isfinite(values[j]) != 0;
    return finite;
}

#if defined(HAVE_AVX2)
AVX2 static int
all_within_avx2(const double *values, Py_ssize_t count, double largest)
{
    return all_within(values, count, largest);
}
#endif

/* Whether the residuals of a piece have not overflowed. */
static int
are_sound(const Runner *self, const double *r, Py_ssize_t count)
{
#if defined(HAVE_AVX2)
    if (self->path == PATH_AVX2)
        return all_within_avx2(r, count, LARGEST);
#endif
    return all_within(r, count, LARGEST);
}

static void
stop_filter(const Runner *self, Py_ssize_t row, scratch *s)
{
    *B1(self, RUNNING, row) = *B1(self, STARTING, row) = 0;
    memset(F8(self, X, row), 0, (size_t)self->n * sizeof(double));
    if (self->first)
        memset(s->seldom.start_sums, 0, (size_t)self->n * sizeof(double));
    if (self->has_gains && *B1(self, APART, row)) {
        *B1(self, APART, row) = 0;
        memset(F8(self, SPREAD, row), 0, (size_t)(self->n * self->n) * sizeof(double));
    }
}

static void
break_filter(const Runner *self, Py_ssize_t row, scratch *s)
{
    stop_filter(self, row, s);
    *s->seldom.broken += 1;
    *I4(self, GAP, row) = 0;
}

static void
start_filter(const Runner *self, Py_ssize_t row, const double *v, scratch *s)
{
    const double *start = PLAN(self, START);
    double *x = F8(self, X, row);
    stop_filter(self, row, s);
    for (Py_ssize_t i = 0; i < self->n; i++) {
        double sum = 0.0;
        for (Py_ssize_t j = 0; j < self->m; j++)
            sum += v[j] * start[i * self->m + j];
        x[i] = sum;
    }
    *B1(self, RUNNING, row) = 1;
    *B1(self, STARTING, row) = self->first > 0;
    *I4(self, AGE, row) = *I4(self, GAP, row) = 0;
}

/* Take out of the state what the start has left in it, and say how far that moves the next residual. */
static void
correct_start(const Runner *self, Py_ssize_t row, scratch *s)
{
    const Py_ssize_t n = self->n, nr = self->nr, ratios = self->n_ratios;
    const double *correction = PLAN(self, CORRECTION), *C = PLAN(self, C_);
    double *x = F8(self, X, row), *sums = s->seldom.start_sums, *left = s->small, *seen = left + n, *moved = seen + nr;
    for (Py_ssize_t i = 0; i < n; i++) {
        left[i] = 0.0;
        for (Py_ssize_t j = 0; j < n; j++)
            left[i] += sums[j] * correction[i * n + j];
    }
    for (Py_ssize_t i = 0; i < nr; i++) {
        seen[i] = 0.0;
        for (Py_ssize_t j = 0; j < n; j++)
            seen[i] += left[j] * C[i * n + j];
    }
    row_product(seen, PLAN(self, RATIOS), nr, ratios, moved);
    const double far = length_of(moved, ratios);
    for (Py_ssize_t i = 0; i < n; i++)
        x[i] -= left[i];
    if (far >= self->moved_from && far > *s->seldom.moved)
        *s->seldom.moved = far;
    memset(sums, 0, (size_t)n * sizeof(double));
    *B1(self, STARTING, row) = 0;
}

/* Add what a residual says of the start: with a constant number of states the loops unroll. */
INLINE void
add_response(const double *restrict r, const double *restrict response, double *restrict sums, double *restrict spare,
             Py_ssize_t nr, Py_ssize_t n)
{
    row_product(r, response, nr, n, spare);
    for (Py_ssize_t j = 0; j < n; j++)
        sums[j] += spare[j];
}

INLINE void
learn_start(const Runner *self, Py_ssize_t row, const double *r, int complete, scratch *s)
{
    const Py_ssize_t n = self->n, nr = self->nr;
    double *sums = s->seldom.start_sums, *spare = s->small, part[4];
    if (!complete) {
        memset(sums, 0, (size_t)n * sizeof(double));
        return;
    }
    const double *response = PLAN(self, ROWS) + (Py_ssize_t)*I4(self, AGE, row) * nr * n;
    if (n == 4)
        add_response(r, response, sums, part, nr, 4);
    else if (n == 3)
        add_response(r, response, sums, part, nr, 3);
    else if (n == 2)
        add_response(r, response, sums, part, nr, 2);
    else
        add_response(r, response, sums, spare, nr, n);
}

/* Which inputs are known and which outputs can be used, of channels that are there; whether no output can. */
INLINE int
find_pattern(const partial_plan *q, flag *pattern)
{
    int is_blank = 1;
    for (Py_ssize_t i = 0; i < q->p; i++) {
        for (Py_ssize_t j = 0; j < q->inputs; j++)
            if (!pattern[j] && q->D[i * q->inputs + j] != 0.0) /* moved at once by an input that is missing */
                pattern[q->inputs + i] = 0;
        is_blank &= !pattern[q->inputs + i];
    }
    return is_blank;
}

/* A sample of a Kalman filter that is off its stationary gain, or of which values are missing; whether enough is known
 * of its state. */
static int
filter_with_gain(const Runner *self, Py_ssize_t row, const double *held, double *r, scratch *s)
{
    const size_t size = (size_t)(self->n * self->n) * sizeof(double);
    double *const x = F8(self, X, row), *const spread = F8(self, SPREAD, row);
    if (*B1(self, STARTING, row)) { /* nothing is known of the state: the recursion finds out, from here on */
        *B1(self, STARTING, row) = 0;
        memset(s->seldom.start_sums, 0, (size_t)self->n * sizeof(double));
        memcpy(spread, self->some.unknown, size);
    }
    const gain *g = find_gain(&s->gains, &self->some, spread, &self->filter, self->path);
    if (g->is_stationary)
        filter_some(self, s, x, one_array(held, self->m), r, 1, NULL);
    else {
        job one = s->filter;
        as_a_whole(&one);
        one.packed = g->packed;
        one.time = one.plants = 1;
        one.x = one.x_next = x;
        one.v = one_array(held, self->m);
        one.r = r;
        one.judge = NULL;
        execute(&one, self->path);
    }
    memcpy(spread, g->after, size);
    *B1(self, APART, row) = (flag)g->is_apart;
    return !g->is_lost;
}

/* One sample where values may be missing, or whose filter starts; whether there is a residual. */
static int
filter_sample(const Runner *self, Py_ssize_t row, const double *held, int complete, double *r, scratch *s)
{
    double *x = F8(self, X, row);
    counter *age = I4(self, AGE, row), *gap = I4(self, GAP, row);
    const int is_blank = !complete && (!self->has_gains || find_pattern(&self->some, s->gains.pattern));
    int with_gain, is_known;
    for (;;) {
        int fresh = 0;
        if (!*B1(self, RUNNING, row)) {
            if (!complete) {
                *gap = stopped((whole)*gap + 1);
                return 0;
            }
            start_filter(self, row, held, s);
            fresh = 1;
        }
        if (is_blank && (whole)*gap + 1 > self->max_hold) { /* too long a gap: wait for a complete sample */
            if (is_finite(x, self->n)) {
                stop_filter(self, row, s);
                *s->seldom.resets += 1;
            } else
                break_filter(self, row, s);
            continue;
        }
        with_gain = self->has_gains && (!complete || *B1(self, APART, row));
        is_known = 1;
        if (with_gain)
            is_known = filter_with_gain(self, row, held, r, s);
        else
            filter_some(self, s, x, one_array(held, self->m), r, 1, NULL);
        if (all_within(r, self->nr, LARGEST)) {
            *gap = is_blank ? stopped((whole)*gap + 1) : 0;
            break;
        }
        break_filter(self, row, s);
        if (fresh) /* a sample that overflows by itself: pass it over */
            return 0;
    }
    if (*B1(self, STARTING, row))
        learn_start(self, row, r, complete, s);
    *age = complete || with_gain ? stopped((whole)*age + 1) : 0;
    if (*B1(self, STARTING, row) && *age == self->first)
        correct_start(self, row, s);
    if (!is_known && is_finite(x, self->n)) { /* so little is known of the state that a new start is better */
        stop_filter(self, row, s);
        *s->seldom.resets += 1;
        *gap = 0;
    } else if (!is_known)
        break_filter(self, row, s);
    return complete;
}

/* A piece of one plant, sample by sample. */
static void
filter_with_gaps(const Runner *self, const block *b, Py_ssize_t plant, Py_ssize_t row, Py_ssize_t k, Py_ssize_t time,
                 scratch *s)
{
    const Py_ssize_t m = self->m, nr = self->nr;
    const double *low = PLAN(self, LOW), *high = PLAN(self, HIGH);
    double *const held = F8(self, HELD, row), *const sample = s->sample;
    for (Py_ssize_t i = 0; i < time; i++) {
        double *r = s->r + i * nr;
        int complete = 1;
        copy_doubles(sample, held, self->held);
        for (Py_ssize_t j = 0; j < m; j++) {
            const double v = deviation(&s->in, i, j);
            const int there = (v >= low[j]) & (v <= high[j]);
            complete &= there;
            if (self->has_gains)
                s->gains.pattern[j] = (flag)there;
            if (there)
                sample[j] = v;
            else if (j >= self->held) /* the gain takes no notice of outputs that are missing */
                sample[j] = 0.0;
            if (!there && b->out[OUT_ASIDE].base != NULL) {
                const char *at = j < self->n_u ? b->u + plant * b->u_strides[0] + (k + i) * b->u_strides[1]
                                                     + j * b->u_strides[2]
                                               : b->y + plant * b->y_strides[0] + (k + i) * b->y_strides[1]
                                                     + (j - self->n_u) * b->y_strides[2];
                if (isfinite(*(const double *)at))
                    out_b1(b, OUT_ASIDE, plant, k + i)[j] = 1;
            }
        }
        if (!complete && b->out[OUT_MISSING].base != NULL)
            *out_b1(b, OUT_MISSING, plant, k + i) = 1;
        s->is_missing = !complete;
        copy_doubles(held, sample, self->held);
        const int known = filter_sample(self, row, sample, complete, r, s);
        s->usable[i] = known && *I4(self, AGE, row) > self->settle;
        if (!known)
            for (Py_ssize_t j = 0; j < nr; j++)
                r[j] = NAN;
    }
}

/* Whether four samples of a piece are run at once. */
INLINE int
goes_in_quads(const Runner *self, Py_ssize_t time, const scratch *s)
{
    return time > 1 && (self->in_columns || (self->in_quads && s->is_short));
}

/* The filter of a piece without gaps, and as much of its test as goes on meanwhile; whether residuals are sound, and
 * signals are values where that was left to it, as far as that is known. */
static int
filter_and_judge(const Runner *self, double *x, double *whitened, Py_ssize_t time, scratch *s)
{
#if defined(HAVE_AVX2)
    if (goes_in_quads(self, time, s)) {
        const Py_ssize_t nr = self->nr;
        const int whitens = !s->may_be_raw;
        quads to = {.limit = self->limit, .squares = s->filter.squares, .apart = s->apart_if_columns, .whitens = whitens};
        for (Py_ssize_t j = 0; j < nr; j++) {
            to.center[j] = (lanes4){0.0} + self->judge[j];
            for (Py_ssize_t l = 0; l < nr; l++)
                to.whitening[j][l] = (lanes4){0.0} + self->judge[4 + 4 * j + l];
        }
        to.columns = self->in_columns && whitens ? s->columns_of_q : NULL;
        to.rows = whitened;
        s->apart = to.columns != NULL ? to.apart : 0;
        s->filter.time = time;
        s->filter.plants = 1;
        s->filter.x = s->filter.x_next = x;
        s->filter.v = s->in;
        s->filter.r = s->r;
        s->filter.judge = self->judge;
        const int is_sound = run_quads(&s->filter, &to);
        s->is_judged = whitens;
        s->is_raw = !whitens && to.sizes <= self->most_raw;
        s->is_within = to.is_within;
        s->is_deferred &= !(to.values <= self->nearest);
        return is_sound;
    }
#endif
    s->is_judged = filter_some(self, s, x, s->in, s->r, time, s->is_short ? NULL : self->judge);
    return 0;
}

/* A piece of one plant; 0 if it is left, untouched, for want of what a Kalman filter with missing values needs. */
static int
filter_piece(const Runner *self, const block *b, Py_ssize_t plant, Py_ssize_t row, Py_ssize_t k, Py_ssize_t time,
             scratch *s)
{
    const Py_ssize_t n = self->n;
    const char *u = b->u + plant * b->u_strides[0] + k * b->u_strides[1];
    const char *y = b->y + plant * b->y_strides[0] + k * b->y_strides[1];
    const int is_apart = self->partial && *B1(self, APART, row);
    const int is_going = *B1(self, RUNNING, row) && !*B1(self, STARTING, row) && !is_apart;
    s->r = b->out[OUT_RESIDUALS].base == NULL ? s->own_r : out_f8(b, OUT_RESIDUALS, plant, k);
    s->is_judged = s->is_within = s->is_raw = 0;
    s->apart = 0;
    s->is_short = time > 1 && self->sums_squares && b->out[OUT_WHITENED].base == NULL;
    const int may_defer = is_going && goes_in_quads(self, time, s);
    int all = gather(self, b, u, y, b->u_strides[1], b->y_strides[1], time, may_defer, s);
    if (all && is_going) {
        double *x = F8(self, X, row), *before = s->small;
        const whole age = *I4(self, AGE, row);
        copy_doubles(before, x, n);
        int is_sound = filter_and_judge(self, x, out_f8(b, OUT_WHITENED, plant, k), time, s);
        is_sound = (is_sound || are_sound(self, s->r, time * self->nr)) && is_finite(x, n);
        if (s->is_deferred)
            all = gather(self, b, u, y, b->u_strides[1], b->y_strides[1], time, 0, s);
        if (all && is_sound) {
            s->is_missing = 0;
            if (age >= self->settle && time > 1)
                memset(s->usable, 1, (size_t)time);
            else
                for (Py_ssize_t i = 0; i < time; i++)
                    s->usable[i] = age + 1 + i > self->settle;
            *I4(self, AGE, row) = stopped(age + time);
            *I4(self, GAP, row) = 0;
            copy_sample(F8(self, HELD, row), &s->in, time - 1, self->held);
            return 1;
        }
        copy_doubles(x, before, n);
        s->is_judged = s->is_raw = 0;
        s->apart = 0;
    }
    if (self->partial && !self->has_gains && (!all || is_apart)) {
        s->wants_gains = 1;
        return 0;
    }
    filter_with_gaps(self, b, plant, row, k, time, s);
    if (k + time == b->time && *B1(self, RUNNING, row) && !is_finite(F8(self, X, row), n))
        break_filter(self, row, s);
    return 1;
}

#endif
