/* The fused loop of residua.monitor.fused: filter, test and isolation in one pass over the data of many plants.
 *
 * A plant is run over pieces of the recording that stay in the cache: its filter first (_plant_filter.h), then test
 * and isolation (_judging.h; of members and groups, _members.h). Of one sample, several plants are run at once
 * (_tick.h). The same bits as NumPy, in place: nothing can fail once the arrays are checked. What a Kalman filter with
 * missing values needs (_partial_gain.h) is brought when the first one is met: the plant stops there, untouched.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <stdlib.h>

#include "../_module.h"
#include "_plant_filter.h"

/* ---- judging a piece --------------------------------------------------------------------------------------------- */

/* The counters of a plant as whole numbers, which are kept afterwards: all `up`, then all `down`, if there are any. */
static void
read_runs(const Runner *self, Py_ssize_t row, Py_ssize_t parts, whole *runs)
{
    for (Py_ssize_t j = 0; j < parts; j++) {
        runs[j] = I4(self, UP, row)[j];
        runs[parts + j] = self->has_state[DOWN] ? I4(self, DOWN, row)[j] : 0;
    }
}

static void
keep_runs(const Runner *self, Py_ssize_t row, Py_ssize_t parts, const whole *runs)
{
    for (Py_ssize_t j = 0; j < parts; j++) {
        I4(self, UP, row)[j] = stopped(runs[j]);
        if (self->has_state[DOWN])
            I4(self, DOWN, row)[j] = stopped(runs[parts + j]);
    }
}

/* Let what is said of a piece stop where the counters do that were there before it. */
static void
stop_counts(const piece *p, const whole *before, Py_ssize_t parts)
{
    whole most = 0;
    for (Py_ssize_t j = 0; j < parts; j++)
        most = before[j] > most ? before[j] : most;
    for (Py_ssize_t i = 0; most + p->time > INT32_MAX && i < p->time; i++)
        p->up[i] = stopped(p->up[i]);
}

/* Numbers that are remembered of the sums of a test: cumulative ones end with whether an alarm stands. */
INLINE Py_ssize_t
kept_sums(const test_plan *t)
{
    return t->sums - (t->kind >= PAGE && t->kind <= PIGNATIELLO_RUNGER);
}

/* Judge a test that remembers, with what is behind its sums. */
INLINE void
judge_remembering(const Runner *self, Py_ssize_t row, test_row test, piece *p, double *part, double *spare,
                  Py_ssize_t k, int has_squares, scratch *s)
{
    const test_plan *t = &self->test;
    const Py_ssize_t kept = kept_sums(t);
    if (kept < t->sums) {
        memcpy(s->stream, test.sums, (size_t)kept * sizeof(double));
        s->stream[kept] = *test.alarm ? 1.0 : 0.0;
        test.sums = s->stream;
    }
    judge_stream(t, &test, p, part, spare, k, has_squares);
    if (kept < t->sums)
        memcpy(F8(self, SUMS, row), s->stream, (size_t)kept * sizeof(double));
}

static test_row
row_of_test(const Runner *self, Py_ssize_t row, whole *runs)
{
    const test_plan *t = &self->test;
    const int is_norm = t->kind == NORM || t->kind == PARTS;
    test_row out = {.up = runs, .down = runs + 1, .alarm = B1(self, ALARM, row)};
    if (is_norm && t->window == 1) /* such a window remembers nothing */
        return out;
    if (is_norm) {
        out.window.values = F8(self, TEST_VALUES, row);
        out.window.begun = F8(self, TEST_BEGUN, row);
        out.window.filled = I8(self, TEST_FILLED, row);
    } else {
        out.past = F8(self, PAST, row);
        out.past_usable = B1(self, PAST_USABLE, row);
        out.sums = F8(self, SUMS, row);
    }
    return out;
}

static window_row
row_of_isolation(const Runner *self, Py_ssize_t row)
{
    const isolation_plan *p = &self->naming;
    window_row out = {NULL, NULL, NULL};
    if (p->kind != NOBODY && p->window != 1)
        out.values = F8(self, VALUES, row);
    if (p->kind != NOBODY && p->window > 1) {
        out.begun = F8(self, BEGUN, row);
        out.filled = I8(self, FILLED, row);
    }
    return out;
}

static void
write_piece(const Runner *self, const block *b, Py_ssize_t plant, Py_ssize_t first, const piece *p)
{
    const Py_ssize_t time = p->time;
    if (b->out[OUT_USABLE].base != NULL)
        copy_flags(out_b1(b, OUT_USABLE, plant, first), p->usable, time);
    if (b->out[OUT_STATISTIC].base != NULL)
        copy_doubles(out_f8(b, OUT_STATISTIC, plant, first), p->statistic, time);
    if (b->out[OUT_WHITENED].base != NULL && !p->is_put)
        copy_doubles(out_f8(b, OUT_WHITENED, plant, first), p->q, time * self->test.k);
    if (p->is_quiet) /* these are zeros where nothing is written */
        return;
    if (b->out[OUT_EXCEEDED].base != NULL)
        copy_flags(out_b1(b, OUT_EXCEEDED, plant, first), p->over, time);
    if (b->out[OUT_ALARM].base != NULL)
        copy_flags(out_b1(b, OUT_ALARM, plant, first), p->alarm, time);
    if (b->out[OUT_UP].base != NULL)
        memcpy(out_f8(b, OUT_UP, plant, first), p->up, (size_t)time * sizeof(whole));
}

/* What is kept of the last sample of a plant; scores of a standing alarm alone. */
static void
write_last(const Runner *self, Py_ssize_t row, const piece *p, const scratch *s, double *spare, Py_ssize_t k)
{
    const Py_ssize_t last = p->time - 1;
    const int alarm = !p->is_quiet && p->alarm[last];
    *B1(self, LAST_FLAGS, row) = (flag)((alarm ? 1 : 0) | (p->usable[last] ? 2 : 0) | (s->is_missing ? 4 : 0));
    *F8(self, LAST_STATISTIC, row) = p->statistic[last];
    *I8(self, LAST_UP, row) = p->is_quiet ? 0 : p->up[last];
    copy_doubles(F8(self, LAST_RESIDUALS, row), s->r + last * self->nr, self->nr);
    if (alarm && self->naming.kind == DIRECTIONS)
        score_sample(&self->naming, p->sums + last * k, p->usable[last], spare, F8(self, LAST_SCORES, row), k);
}

static part_row
row_of_parts(const Runner *self, Py_ssize_t row, whole *runs)
{
    part_row out = {.up = runs, .down = runs + self->test.parts, .alarm = B1(self, ALARM, row)};
    if (self->naming.kind == CODES) {
        out.since = I8(self, SINCE, row);
        out.fired = B1(self, FIRED, row);
        out.counts = row_of_isolation(self, row);
    }
    return out;
}

static part_piece
outputs_of_parts(const block *b, Py_ssize_t plant, Py_ssize_t first, const scratch *s)
{
    part_piece m = s->parts;
    m.before = s->count;
    if (b->out[OUT_PARTS].base != NULL)
        m.statistics = out_f8(b, OUT_PARTS, plant, first);
    if (b->out[OUT_FIRED].base != NULL)
        m.fired = out_b1(b, OUT_FIRED, plant, first);
    if (b->out[OUT_CODE].base != NULL)
        m.code = out_b1(b, OUT_CODE, plant, first);
    return m;
}

/* What is written of parts that were tested, and who is named by them. */
INLINE void
name_parts(const Runner *self, const block *b, Py_ssize_t plant, Py_ssize_t row, Py_ssize_t first, piece *p,
           part_piece *m, const part_row *own, scratch *s)
{
    const test_plan *t = &self->test;
    const isolation_plan *n = &self->naming;
    const Py_ssize_t time = p->time;
    double *const spare = s->small;
    write_piece(self, b, plant, first, p);
    if (n->kind == DIRECTIONS)
        name_by_direction(n, row_of_isolation(self, row), p, spare, s->columns, t->k);
    if (n->kind == CODES)
        read_codes(n, own, p, m);
    if (!self->has_state[LAST_FLAGS])
        return;
    write_last(self, row, p, s, spare, t->k);
    if (n->kind == CODES) {
        const flag *code = m->code + (time - 1) * n->k;
        memcpy(B1(self, LAST_CODE, row), code, (size_t)n->k);
        if (n->groups && !p->is_quiet && p->alarm[time - 1])
            agreements(n, code, p->usable[time - 1], F8(self, LAST_SCORES, row));
    }
}

/* The same of parts that are tested one by one. */
INLINE void
judge_parts(const Runner *self, const block *b, Py_ssize_t plant, Py_ssize_t row, Py_ssize_t first, Py_ssize_t time,
            scratch *s)
{
    const test_plan *t = &self->test;
    const isolation_plan *n = &self->naming;
    whole *const runs = s->runs, *const before = runs + 2 * t->parts;
    const test_row test = row_of_test(self, row, runs);
    const part_row own = row_of_parts(self, row, runs);
    double *const spare = s->small;
    part_piece m = outputs_of_parts(b, plant, first, s);
    piece p = {time, s->r, s->q, s->sums, s->statistic, out_f8(b, OUT_SCORES, plant, first), s->e, s->history,
               s->usable, s->over, s->alarm, s->up};
    if (b->out[OUT_READY].base != NULL)
        copy_flags(out_b1(b, OUT_READY, plant, first), s->usable, time);
    if (t->kind == MEANS) {
        whiten_parts(t, &p, spare);
        means_of_parts(t, &test, &p, &m, spare);
        read_runs(self, row, 1, runs);
        const whole before_it = runs[0];
        alarms_of_means(t, &own, &p, &m);
        stop_counts(&p, &before_it, 1);
        keep_runs(self, row, 1, runs);
        name_parts(self, b, plant, row, first, &p, &m, &own, s);
        return;
    }
    const int is_read = n->kind == DIRECTIONS || b->out[OUT_WHITENED].base != NULL;
    const int keeps = t->window > 1 || (t->joint == NULL && is_read);
    const int is_whitened = time > 1 && squares_by_column(t, &p, &m, keeps);
    if (!is_whitened)
        whiten_parts(t, &p, spare);
    if (is_whitened && t->window == 1)
        norms_by_column(t, &p, &m);
    else
        norms_of_parts(t, test.window, &p, &m);
    read_runs(self, row, t->parts, runs);
    memcpy(before, runs, (size_t)t->parts * sizeof(whole));
    alarms_of_parts(t, &own, &p, &m);
    stop_counts(&p, before, t->parts);
    keep_runs(self, row, t->parts, runs);
    if (t->joint != NULL)
        joint_residuals(t, &p, spare);
    name_parts(self, b, plant, row, first, &p, &m, &own, s);
}

/* Whether no sample is over the threshold, and nobody asks how far below it they are. */
INLINE int
is_calm(const Runner *self, const block *b, const test_row *row, const piece *p)
{
    return p->is_judged && p->is_within && self->sums_squares && self->test.window == 1 && !*row->up && !*row->alarm
           && b->out[OUT_STATISTIC].base == NULL && all_set(p->usable, p->time);
}

INLINE void
judge_piece(const Runner *self, const block *b, Py_ssize_t plant, Py_ssize_t row, Py_ssize_t first, Py_ssize_t time,
            scratch *s, Py_ssize_t nr, Py_ssize_t k)
{
    const test_plan *t = &self->test;
    whole runs[2];
    const test_row test = row_of_test(self, row, runs);
    double *part = s->small, *spare = part + k + t->sums + t->directions + 2;
    piece p = {time, s->r, s->q, s->sums, s->statistic, out_f8(b, OUT_SCORES, plant, first), s->e, s->history,
               s->usable, s->over, s->alarm, s->up, .is_judged = s->is_judged, .is_laned = self->path == PATH_AVX2};
    if (b->out[OUT_READY].base != NULL)
        copy_flags(out_b1(b, OUT_READY, plant, first), s->usable, time);
    p.is_within = s->is_within;
    p.is_raw = s->is_raw && all_set(p.usable, time);
    p.rows = s->e;
    read_runs(self, row, 1, runs);
    if (is_calm(self, b, &test, &p)) {
        p.statistic[time - 1] = sqrt(p.statistic[time - 1]);
        *test.down += time;
        keep_runs(self, row, 1, runs);
        p.is_quiet = 1;
        write_piece(self, b, plant, first, &p);
        if (self->has_state[LAST_FLAGS])
            write_last(self, row, &p, s, spare, k);
        return;
    }
    const int has_squares = !p.is_raw && ((s->is_short && !p.is_judged && squares_of_rows(t, &p, nr, k))
                                          || whiten(t, &p, nr, k));
    p.apart = has_squares ? s->apart : 0;
    p.is_put = p.apart != 0;
    if (t->kind == NORM)
        judge_norm(t, &test, &p, k, has_squares);
    else
        judge_remembering(self, row, test, &p, part, spare, k, has_squares, s);
    const whole before = runs[0];
    raise_alarms(t, &test, &p);
    stop_counts(&p, &before, 1);
    keep_runs(self, row, 1, runs);
    write_piece(self, b, plant, first, &p);
    if (self->naming.kind == DIRECTIONS)
        name_by_direction(&self->naming, row_of_isolation(self, row), &p, spare, s->columns, k);
    if (self->has_state[LAST_FLAGS])
        write_last(self, row, &p, s, spare, k);
}

/* Each of these is a function of its own: as one function they take a compiler many times as long. With constant numbers
 * of residuals the loops over them unroll; that is worth its time where the widest vectors are. */
#define JUDGED                                                                                                        \
    const Runner *self, const block *b, Py_ssize_t plant, Py_ssize_t row, Py_ssize_t first, Py_ssize_t time, scratch *s
typedef void (*judging)(JUDGED);
#define DEFINE_JUDGE(FAMILY, TARGET, NR, K)                                                                           \
    TARGET static void judge_##FAMILY(JUDGED) { judge_piece(self, b, plant, row, first, time, s, NR, K); }
#define DEFINE_JUDGE_OF_ANY(FAMILY, TARGET)                                                                           \
    TARGET static void judge_parts_##FAMILY(JUDGED) { judge_parts(self, b, plant, row, first, time, s); }             \
    DEFINE_JUDGE(FAMILY, TARGET, self->nr, self->test.k)
DEFINE_JUDGE_OF_ANY(plain, )
#if defined(HAVE_AVX2)
DEFINE_JUDGE_OF_ANY(avx2, AVX2)
#define WIDEST AVX2
#else
#define WIDEST
#endif
DEFINE_JUDGE(1, WIDEST, 1, 1)
DEFINE_JUDGE(2, WIDEST, 2, 2)
DEFINE_JUDGE(3, WIDEST, 3, 3)
DEFINE_JUDGE(4, WIDEST, 4, 4)

static judging
judging_of(const Runner *self)
{
    static const judging few[4] = {judge_1, judge_2, judge_3, judge_4};
    const int is_few = self->nr == self->test.k && self->nr >= 1 && self->nr <= 4;
#if defined(HAVE_AVX2)
    if (self->path == PATH_AVX2)
        return self->test.parts ? judge_parts_avx2 : is_few ? few[self->nr - 1] : judge_avx2;
    return self->test.parts ? judge_parts_plain : judge_plain;
#else
    return self->test.parts ? judge_parts_plain : is_few ? few[self->nr - 1] : judge_plain;
#endif
}

static void
judge(JUDGED)
{
    judging_of(self)(self, b, plant, row, first, time, s);
}

/* Write what a block leaves of a plant where nothing is written else. */
static void
clear_outputs(const Runner *self, const block *b, Py_ssize_t place)
{
    const size_t time = (size_t)b->time;
    const int which[] = {OUT_MISSING, OUT_ASIDE, OUT_EXCEEDED, OUT_ALARM, OUT_UP};
    const size_t bytes[] = {time, time * (size_t)self->m, time, time, time * sizeof(whole)};
    for (int j = 0; j < 5; j++)
        if (b->out[which[j]].base != NULL) {
            flag *at = out_b1(b, which[j], place, 0);
            if (bytes[j] == 1)
                *at = 0;
            else if (bytes[j] == sizeof(double))
                clear_doubles(at, 1);
            else
                memset(at, 0, bytes[j]);
        }
}

/* The filter of some samples that are judged at once, piece by piece; of how many, if one is left. */
static Py_ssize_t
filter_pieces(const Runner *self, const block *b, Py_ssize_t plant, Py_ssize_t row, Py_ssize_t k, Py_ssize_t time,
              scratch *s)
{
    s->may_be_raw = self->most_raw > 0.0 && time >= LANES * LEAST_LANE && b->out[OUT_WHITENED].base == NULL;
    if (time <= PIECE)
        return filter_piece(self, b, plant, row, k, time, s) ? time : 0;
    const scratch whole = *s;
    const Py_ssize_t apart = self->in_columns ? s->apart_if_columns : 0;
    int is_judged = 1, is_within = 1, is_raw = 1;
    Py_ssize_t done = 0;
    while (done < time) {
        const Py_ssize_t some = time - done < PIECE ? time - done : PIECE;
        s->usable = whole.usable + done;
        s->own_r = whole.own_r + done * self->nr;
        s->filter.q = whole.q + done * self->test.k;
        s->columns_of_q = whole.q + done;
        s->filter.squares = whole.statistic + done;
        if (!filter_piece(self, b, plant, row, k + done, some, s))
            break;
        is_judged &= s->is_judged && s->apart == apart; /* a single sample is judged in a row */
        is_within &= s->is_within;
        is_raw &= s->is_raw;
        done += some;
    }
    s->usable = whole.usable;
    s->own_r = whole.own_r;
    s->filter.q = whole.filter.q;
    s->filter.squares = whole.filter.squares;
    s->r = b->out[OUT_RESIDUALS].base == NULL ? s->own_r : out_f8(b, OUT_RESIDUALS, plant, k);
    s->columns_of_q = whole.columns_of_q;
    s->is_raw = is_raw;
    s->is_judged = is_judged;
    s->apart = is_judged ? apart : 0;
    s->is_within = is_within;
    return done;
}

/* Put inputs and outputs of some samples side by side, while they are in the cache. */
static void
join_signals(const Runner *self, const block *b, Py_ssize_t plant, Py_ssize_t k, Py_ssize_t time)
{
    const Py_ssize_t n_u = self->n_u, n_y = self->n_y, u_step = b->u_strides[1], y_step = b->y_strides[1];
    const char *u = b->u + plant * b->u_strides[0] + k * u_step, *y = b->y + plant * b->y_strides[0] + k * y_step;
    double *to = (double *)(b->joined.base + plant * b->joined.plant + k * b->joined.time);
    if (b->is_dense)
        for (Py_ssize_t i = 0; i < time; i++, u += u_step, y += y_step)
            to = copy_few(copy_few(to, u, n_u), y, n_y);
    else
        for (Py_ssize_t i = 0; i < time; i++, u += u_step, y += y_step) {
            for (Py_ssize_t j = 0; j < n_u; j++)
                memcpy(to++, u + j * b->u_strides[2], sizeof(double));
            for (Py_ssize_t j = 0; j < n_y; j++)
                memcpy(to++, y + j * b->y_strides[2], sizeof(double));
        }
}

static Py_ssize_t
run_plant(const Runner *self, const block *b, Py_ssize_t plant, Py_ssize_t row, Py_ssize_t k, scratch *s)
{
    const Py_ssize_t begin = k;
    if (!open_seldom(self, row, s))
        return k;
    if (b->is_used)
        clear_outputs(self, b, plant);
    while (k < b->time) {
        const Py_ssize_t time = b->time - k < self->span ? b->time - k : self->span;
        const Py_ssize_t done = filter_pieces(self, b, plant, row, k, time, s);
        if (done == 0)
            break;
        if (b->joined.base != NULL)
            join_signals(self, b, plant, k, done);
        s->count = *I8(self, COUNT, row) + k - begin;
        judge(self, b, plant, row, k, done, s);
        k += done;
    }
    *I8(self, COUNT, row) += k - begin;
    close_seldom(self, row, s);
    return k;
}

#include "_tick.h"

/* ---- Python: arrays ---------------------------------------------------------------------------------------------- */

static int
take(PyObject *object, Py_buffer *view, const char *format, Py_ssize_t items, int writable, const char *what, int which)
{
    if (PyObject_GetBuffer(object, view, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (writable ? PyBUF_WRITABLE : 0)) < 0)
        return -1;
    if (view->format != NULL && strchr(format, view->format[0]) && view->format[1] == 0
        && view->len == items * view->itemsize && is_aligned(view))
        return 0;
    PyErr_Format(PyExc_ValueError, "array %d of the %s has another type or size, or is not aligned", which, what);
    PyBuffer_Release(view);
    return -1;
}

/* An array with a row for each plant, whose numbers lie side by side. */
static int
take_rows(Runner *self, PyObject *object, int which, const char *format, Py_ssize_t width)
{
    Py_buffer *view = &self->state[which];
    if (PyObject_GetBuffer(object, view, PyBUF_STRIDES | PyBUF_FORMAT | PyBUF_WRITABLE) < 0)
        return -1;
    Py_ssize_t items = 1, expected = view->itemsize;
    int fits = view->ndim >= 1 && view->format != NULL && strchr(format, view->format[0]) && view->format[1] == 0
               && view->shape[0] == self->plants && (format[0] != 'i' || view->itemsize == sizeof(counter));
    for (int d = view->ndim - 1; fits && d > 0; d--) {
        fits = view->strides[d] == expected || view->shape[d] <= 1;
        expected *= view->shape[d];
        items *= view->shape[d];
    }
    if (fits && items == width && is_aligned(view)) {
        self->base[which] = view->buf;
        self->stride[which] = view->strides[0];
        return 0;
    }
    PyErr_Format(PyExc_ValueError, "array %d of the state has another type or size, or is not aligned", which);
    PyBuffer_Release(view);
    return -1;
}

static int
take_all(Runner *self, PyObject *plan, PyObject *state)
{
    const test_plan *t = &self->test;
    const isolation_plan *p = &self->naming;
    const Py_ssize_t n = self->n, m = self->m, nr = self->nr, k = t->k;
    const Py_ssize_t plan_sizes[PLAN_ARRAYS] = {
        n * n, n * m, nr * n, nr * m, n * m, m, m, m, (Py_ssize_t)self->first * nr * n, n * n, nr * self->n_ratios, nr,
        nr * k, t->order * k * k, k * k, k * t->knots_of_each, t->knots_of_each, k * t->directions, k * p->columns,
        p->groups, t->parts, t->parts, nr * k, p->groups * p->k,
        t->scales * (k * k + 1) + 3 * (t->parts ? t->parts : 1), partial_numbers(n, self->some.inputs, self->some.p)};
    const Py_ssize_t counted = t->kind == PARTS ? t->parts : 1, parts = t->parts ? t->parts : 1;
    const Py_ssize_t state_sizes[STATE_ARRAYS] = {
        n, self->held, 1, 1, 1, 1, 1, 1, n, 1, 1, n * n, 1, t->window * k, k, 1, t->order * k, t->order, kept_sums(t), counted, counted,
        parts, (p->window ? p->window : LONG_MEANS) * p->k, p->k, 1, p->k, p->k, 1, 1, nr, 1, p->groups, p->k};
    const char *const formats[STATE_ARRAYS] = {"d", "d", "il", "?", "il", "lq", "lq", "?",  "d", "d", "?", "d", "lq",
                                               "d", "d", "lq", "d", "?",  "d",  "il", "il", "?", "d", "d", "lq",
                                               "lq", "?", "B", "d", "d", "lq", "d", "?"};
    for (int j = 0; j < PLAN_ARRAYS; j++) {
        PyObject *one = PyTuple_GetItem(plan, j);
        const char *format = j == DIMENSIONS || j == SIZES ? "lq" : j == CODE_TABLE ? "?" : "d";
        if (one == NULL || (one != Py_None && take(one, &self->plan[j], format, plan_sizes[j], 0, "plan", j) < 0))
            return -1;
        self->has_plan[j] = one != Py_None;
    }
    for (int j = 0; j < STATE_ARRAYS; j++) {
        PyObject *one = PyTuple_GetItem(state, j);
        if (one == NULL || (one != Py_None && take_rows(self, one, j, formats[j], state_sizes[j]) < 0))
            return -1;
        self->has_state[j] = one != Py_None;
    }
    const char *const has = self->has_state;
    self->has_starts = self->first && has[START_SUMS] && has[MOVED];
    self->lacks_room = !has[RESETS] || !has[BROKEN] || !has[MOVED] || (self->first && !has[START_SUMS]);
    return 0;
}

/* Whether everything that will be read is there. */
static int
is_complete(const Runner *self)
{
    int complete = 1;
    const int parts = self->test.parts > 0, norm = self->test.kind == NORM || self->test.kind == PARTS;
    const int kind = self->naming.kind, named = kind != NOBODY;
    for (int j = 0; j < PLAN_ARRAYS; j++) {
        const int needed = j <= HIGH || j == CENTER || j == WHITENING || (self->first && j <= RATIOS)
                           || (self->test.order && (j == COEFFICIENTS || j == REWHITENING))
                           || (self->test.knots_of_each && (j == KNOTS || j == SCORES))
                           || (self->test.kind == DIRECTED_GLR && j == ALONG)
                           || (kind == DIRECTIONS && (j == BASES || j == DIMENSIONS))
                           || (parts && (j == SIZES || j == LIMITS)) || (kind == CODES && j == CODE_TABLE)
                           || (self->test.kind == MEANS && j == MEAN_NUMBERS);
        complete &= self->has_plan[j] || !needed;
    }
    for (int j = 0; j < STATE_ARRAYS; j++) {
        const int is_seldom = j == SPREAD || j == START_SUMS || j == MOVED || j == RESETS || j == BROKEN;
        const int needed = (j <= COUNT && !is_seldom) || j == UP || j == ALARM || (norm && j == DOWN)
                           || (norm && self->test.window > 1 && j >= TEST_VALUES && j <= TEST_FILLED)
                           || (!norm && j >= PAST && j <= SUMS)
                           || (named && self->naming.window != 1 && j == VALUES)
                           || (named && self->naming.window > 1 && (j == BEGUN || j == FILLED))
                           || (kind == CODES && (j == SINCE || j == FIRED))
                           || (self->has_state[LAST_FLAGS] && j > LAST_FLAGS
                               && (j != LAST_SCORES || self->naming.groups) && (j != LAST_CODE || kind == CODES));
        complete &= self->has_state[j] || !needed;
    }
    complete &= !self->partial || self->has_plan[PARTIAL_NUMBERS] == self->has_state[SPREAD];
    if (!complete)
        PyErr_SetString(PyExc_ValueError, "an array that is needed is None");
    return complete;
}

/* Whether no state points beyond an array: it may come from a file. */
static int
points_inside(const Runner *self)
{
    const int norm = (self->test.kind == NORM || self->test.kind == PARTS) && self->test.window > 1;
    const int named = self->naming.kind != NOBODY && self->naming.window > 1;
    for (Py_ssize_t p = 0; p < self->plants; p++) {
        const whole test = norm ? *I8(self, TEST_FILLED, p) : 0, naming = named ? *I8(self, FILLED, p) : 0;
        const whole age = *B1(self, STARTING, p) ? *I4(self, AGE, p) : 0;
        if (test < 0 || test >= self->test.window || naming < 0 || naming >= (named ? self->naming.window : 1)
            || age < 0 || (*B1(self, STARTING, p) && (age >= self->first || !self->has_starts))) {
            PyErr_SetString(PyExc_ValueError, "a state that cannot be");
            return 0;
        }
    }
    return 1;
}

/* Where the part of a record begins that every sample touches, if what is remembered of a plant lies side by side. */
static void
find_records(Runner *self)
{
    const int touched[] = {X,  HELD, GAP,   RUNNING,    AGE,            STARTING,       COUNT,
                           UP, DOWN, ALARM, LAST_FLAGS, LAST_STATISTIC, LAST_RESIDUALS, LAST_UP};
    const char *low = self->base[COUNT], *high = low + 8;
    self->record_size = 0;
    for (size_t j = 0; j < sizeof touched / sizeof *touched; j++) {
        const int which = touched[j];
        if (!self->has_state[which] || self->state[which].len == 0)
            continue;
        const char *begin = self->base[which], *end = begin + self->state[which].len / self->plants;
        if (self->stride[which] != self->stride[COUNT])
            return;
        low = begin < low ? begin : low;
        high = end > high ? end : high;
    }
    if (high - low > self->stride[COUNT])
        return;
    self->records = self->base[COUNT] - (self->base[COUNT] - low);
    self->record_size = high - low;
    for (int which = 0; which < STATE_ARRAYS; which++)
        self->offset[which] = self->has_state[which] ? self->base[which] - self->records : 0;
}

static int
read_plan(Runner *self, const whole *i, const double *d)
{
    self->n = (Py_ssize_t)i[N];
    self->n_u = (Py_ssize_t)i[N_U];
    self->n_y = (Py_ssize_t)i[N_Y];
    self->m = self->n_u + self->n_y;
    self->nr = (Py_ssize_t)i[N_R];
    self->n_ratios = (Py_ssize_t)i[N_RATIOS];
    self->settle = i[SETTLE];
    self->max_hold = i[MAX_HOLD];
    self->first = i[FIRST];
    self->partial = i[PARTIAL] != 0;
    self->some.n = self->n;
    self->some.inputs = (Py_ssize_t)i[PLANT_INPUTS];
    self->some.p = self->m - self->some.inputs;
    self->held = self->partial ? self->some.inputs : self->m;
    self->moved_from = d[MOVED_FROM];
    test_plan *t = &self->test;
    t->kind = (int)i[TEST_KIND];
    t->nr = self->nr;
    t->k = (Py_ssize_t)i[K];
    t->window = (Py_ssize_t)i[WINDOW];
    t->persistence = i[PERSISTENCE];
    t->release = i[RELEASE];
    t->order = (Py_ssize_t)i[ORDER];
    t->knots_of_each = (Py_ssize_t)i[N_KNOTS];
    t->sums = (Py_ssize_t)i[N_SUMS];
    t->directions = (Py_ssize_t)i[N_ALONG];
    t->root = sqrt((double)t->window);
    t->threshold = d[THRESHOLD];
    t->release_level = d[RELEASE_LEVEL];
    t->allowance = d[ALLOWANCE];
    t->old_weight = d[OLD_WEIGHT];
    t->new_weight = d[NEW_WEIGHT];
    t->deviation = d[DEVIATION];
    t->parts = (Py_ssize_t)i[N_PARTS];
    t->scales = (Py_ssize_t)i[N_SCALES];
    self->naming.groups = (Py_ssize_t)i[GROUPS];
    self->naming.kind = i[MEMBERS] ? CODES : i[GROUPS] ? DIRECTIONS : NOBODY;
    self->naming.k = i[MEMBERS] ? (Py_ssize_t)i[MEMBERS] : t->k;
    self->naming.is_at_once = i[AT_ONCE] != 0;
    self->naming.share = d[SHARE];
    self->naming.clear = d[CLEAR];
    self->naming.window = (Py_ssize_t)i[ISOLATION_WINDOW];
    self->naming.columns = (Py_ssize_t)i[COLUMNS];
    self->naming.room = (self->naming.columns + 7) / 8 * 8;
    for (int j = 0; j < INTEGERS; j++)
        if (i[j] < 0 || i[j] > (whole)1 << 40)
            return -1;
    const Py_ssize_t width = t->kind == DIRECTED_GLR ? t->directions : t->kind == CHI_SQUARED ? 1 : t->k;
    const Py_ssize_t sums[] = {[NORM] = 0, [PAGE] = 2 * t->k + 1, [CROSIER] = t->k + 1,
                               [PIGNATIELLO_RUNGER] = t->k + 2, [EWMA] = t->k, [CHI_SQUARED] = (t->window - 1) * width,
                               [GLR] = (t->window - 1) * width, [DIRECTED_GLR] = (t->window - 1) * width,
                               [PARTS] = 0, [MEANS] = (t->scales - 1) * t->k};
    if (self->partial && (self->some.inputs > self->m || self->some.p != self->nr))
        return -1;
    return t->kind < NORM || t->kind > MEANS || t->window < 1 || t->sums != sums[t->kind]
                   || (self->naming.kind == CODES && self->naming.window < 1) || t->knots_of_each == 1
                   || (t->kind == PARTS && !t->parts) || (t->kind != PARTS && t->kind != MEANS && t->parts)
                   || (t->kind == MEANS) != (t->scales > 0)
                   || (self->naming.kind == CODES && self->naming.k != t->parts)
               ? -1
               : 0;
}

static int
check_dimensions(Runner *self)
{
    const whole *dimensions = self->plan[DIMENSIONS].buf;
    whole columns = 0;
    self->naming.are_lines = 1;
    for (Py_ssize_t g = 0; g < self->naming.groups; g++) {
        if (dimensions[g] < 0 || dimensions[g] > self->naming.columns)
            return -1;
        columns += dimensions[g];
        self->naming.are_lines &= dimensions[g] == 1;
    }
    return columns == self->naming.columns ? 0 : -1;
}

/* Which residuals each whitened one of a part takes; 0 if the sizes of the parts do not add up, -1 without memory. */
static int
point_at_parts(Runner *self)
{
    test_plan *t = &self->test;
    const Py_ssize_t k = t->k, nr = self->nr, parts = t->parts;
    const whole *sizes = self->plan[SIZES].buf;
    whole columns = 0;
    for (Py_ssize_t j = 0; j < parts; j++) {
        if (sizes[j] < 0 || sizes[j] > k)
            return 0;
        columns += sizes[j];
    }
    if (columns != k)
        return 0;
    t->terms = 0;
    for (Py_ssize_t j = 0; j < k; j++) {
        Py_ssize_t terms = 0;
        for (Py_ssize_t i = 0; i < nr; i++)
            terms += PLAN(self, WHITENING)[i * k + j] != 0.0;
        t->terms = terms > t->terms ? terms : t->terms;
    }
    self->parts_room = PyMem_Calloc((size_t)(2 * t->terms * k + parts + 1), sizeof(double));
    if (self->parts_room == NULL)
        return -1;
    double *const weights = self->parts_room; /* zeros where a column takes fewer, of the first residual */
    whole *const from = (whole *)(weights + t->terms * k), *const begins = from + t->terms * k;
    for (Py_ssize_t j = 0; j < k; j++)
        for (Py_ssize_t i = 0, l = 0; i < nr; i++)
            if (PLAN(self, WHITENING)[i * k + j] != 0.0) {
                from[l * k + j] = i;
                weights[l++ * k + j] = PLAN(self, WHITENING)[i * k + j];
            }
    for (Py_ssize_t j = 0; j < parts; j++)
        begins[j + 1] = begins[j] + sizes[j];
    t->weights = weights;
    t->from = from;
    t->begins = begins;
    t->limits = PLAN(self, LIMITS);
    t->joint = self->has_plan[JOINT] ? PLAN(self, JOINT) : NULL;
    return 1;
}

/* The largest square whose root is not over a threshold, of those that do not overflow a sum. */
static double
largest_square(double threshold)
{
    double square = threshold * threshold;
    if (!(threshold >= 0.0))
        return -1.0;
    if (!(square < LARGEST_SQUARES))
        return LARGEST_SQUARES;
    while (square > 0.0 && sqrt(square) > threshold)
        square = nextafter(square, 0.0);
    while (sqrt(nextafter(square, DBL_MAX)) <= threshold)
        square = nextafter(square, DBL_MAX);
    return square;
}

/* How large residuals may be together so that none, whitened, is too large; 0 if that depends. */
static double
most_raw(const test_plan *t)
{
    const double large = 1e50; /* its product with a weight of that size, and as much again, is far from LARGEST_WHITENED */
    for (Py_ssize_t j = 0; j < t->nr; j++) {
        if (!(fabs(t->center[j]) <= large))
            return 0.0;
        for (Py_ssize_t c = 0; c < t->k; c++)
            if (!(fabs(t->whitening[j * t->k + c]) <= large))
                return 0.0;
    }
    return large;
}

static void
point_at_plan(Runner *self)
{
    test_plan *t = &self->test;
    t->center = PLAN(self, CENTER);
    t->whitening = PLAN(self, WHITENING);
    t->coefficients = PLAN(self, COEFFICIENTS);
    t->rewhitening = PLAN(self, REWHITENING);
    t->knots = PLAN(self, KNOTS);
    t->scores = PLAN(self, SCORES);
    t->along = PLAN(self, ALONG);
    if (t->kind == MEANS) {
        t->mean_weights = PLAN(self, MEAN_NUMBERS);
        const Py_ssize_t parts = t->parts ? t->parts : 1;
        t->clips = t->mean_weights + t->scales;
        t->fulls = t->clips + parts;
        t->releases = t->fulls + parts;
        t->scaling = t->releases + parts;
    }
    self->naming.dimensions = self->plan[DIMENSIONS].buf;
    self->naming.codes = self->plan[CODE_TABLE].buf;
    for (Py_ssize_t i = 0; i < self->nr && self->nr <= 4 && t->k <= 4; i++) {
        t->padded[i] = t->center[i];
        for (Py_ssize_t j = 0; j < t->k; j++)
            t->padded[4 + 4 * i + j] = t->whitening[i * t->k + j];
    }
    self->judge = self->nr <= 4 && t->k <= 4 ? t->padded : NULL;
    self->span = self->path == PATH_AVX2 && t->kind == CROSIER && t->k <= MAX_LANED ? LONG_PIECE : PIECE;
    self->sums_squares = self->judge != NULL && self->naming.kind == NOBODY
                         && ((t->kind == NORM && t->window == 1)
                             || (t->kind == CHI_SQUARED && !t->order && !t->knots_of_each));
    const int is_square = self->path == PATH_AVX2 && self->judge != NULL && t->k == self->nr && t->k >= 1 && self->n >= 1
                          && self->n <= MAX_SMALL;
    self->in_quads = is_square && self->sums_squares;
    const int is_summed = t->kind == CROSIER && !t->order && !t->knots_of_each && self->naming.kind == NOBODY;
    const int is_plain_mean = t->kind == MEANS && !t->order && !t->parts;
    self->in_columns = is_square && (is_summed || is_plain_mean
                                     || (t->kind == NORM && t->window == 1 && self->naming.kind == DIRECTIONS));
    self->most_raw = is_square && is_summed ? most_raw(t) : 0.0;
    self->limit = self->sums_squares && t->window == 1 ? largest_square(t->threshold) : LARGEST_SQUARES;
    const int limits[3] = {OFFSET, LOW, HIGH};
    const Py_ssize_t begins[3] = {0, 0, self->n_u}, ends[3] = {self->m, self->n_u, self->m};
    double *tile = self->tile;
    for (int part = 0; part < 3; part++)
        for (int j = 0; j < 3; j++)
            for (Py_ssize_t sample = 0; sample < 4; sample++)
                for (Py_ssize_t i = begins[part]; i < ends[part]; i++)
                    *tile++ = PLAN(self, limits[j])[i];
    double *padded = tile;
    for (Py_ssize_t j = 0; j < t->k; j++)
        for (Py_ssize_t c = 0; c < self->naming.room; c++)
            *tile++ = c < self->naming.columns ? PLAN(self, BASES)[j * self->naming.columns + c] : 0.0;
    self->naming.padded = padded;
    self->has_offset = 0; /* a negative zero counts as one: 0 less that is 0, whatever the sign */
    for (Py_ssize_t i = 0; i < self->m; i++)
        self->has_offset |= PLAN(self, OFFSET)[i] != 0.0 || signbit(PLAN(self, OFFSET)[i]);
    self->nearest = self->has_offset ? 0.0 : nearest_limit(self->tile, 4 * self->m);
    self->has_gains = self->partial && self->has_plan[PARTIAL_NUMBERS];
    if (self->has_gains)
        point_at_partial(&self->some, PLAN(self, PARTIAL_NUMBERS));
    job *q = &self->filter;
    q->n = self->n;
    q->m = self->m;
    q->nr = self->nr;
    q->A = PLAN(self, A_);
    q->B = PLAN(self, B_);
    q->C = PLAN(self, C_);
    q->D = PLAN(self, D_);
    as_a_whole(q);
}

/* Pack the matrices of the filter, as a whole and section by section. */
static int
pack_filter(Runner *self)
{
    job *const q = &self->filter;
    Py_ssize_t size = 8;
    execute(q, self->path); /* without plants it only packs */
    job *const start = &self->starter;
    start->n = start->time = 1;
    start->m = self->m;
    start->nr = self->n;
    start->A = start->B = start->C = start->x = self->zeros;
    start->D = PLAN(self, START);
    start->v = one_array(NULL, self->m);
    as_a_whole(start);
    execute(start, self->path);
    start->is_packed = 1;
    q->is_packed = 1;
    self->sections = find_sections(q, &q->n_sections, &size);
    if (self->sections == NULL)
        return 0;
    self->sections_room = PyMem_Malloc((size_t)size * sizeof(double));
    if (self->sections_room == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    place_sections(self->sections, q->n_sections, q->m, line_of(self->sections_room));
    q->sections = self->sections;
    pack_sections(q, self->path);
    return 0;
}

static PyObject *
runner_new(PyTypeObject *type, PyObject *args, PyObject *keywords)
{
    (void)keywords;
    PyObject *integers, *numbers, *plan, *state;
    Py_ssize_t plants;
    int path;
    if (!PyArg_ParseTuple(args, "OOO!O!ni", &integers, &numbers, &PyTuple_Type, &plan, &PyTuple_Type, &state, &plants,
                          &path))
        return NULL;
    allocfunc allocate = (allocfunc)PyType_GetSlot(type, Py_tp_alloc);
    Runner *self = (Runner *)allocate(type, 0);
    if (self == NULL)
        return NULL;
    Py_buffer i, d;
    int status = -1;
    self->plants = plants;
    self->path = path;
    if (take(integers, &i, "lq", INTEGERS, 0, "integers", 0) == 0) {
        if (take(numbers, &d, "d", NUMBERS, 0, "numbers", 0) == 0) {
            status = read_plan(self, i.buf, d.buf);
            PyBuffer_Release(&d);
            if (status < 0 || path < 0 || path > best_path() || plants < 0)
                status = -1, PyErr_SetString(PyExc_ValueError, "these integers are no plan");
        }
        PyBuffer_Release(&i);
    }
    if (status == 0 && (take_all(self, plan, state) < 0 || !is_complete(self)))
        status = -1;
    if (status == 0 && !points_inside(self))
        status = -1;
    if (status == 0 && self->naming.kind == DIRECTIONS && check_dimensions(self) < 0)
        status = -1, PyErr_SetString(PyExc_ValueError, "the dimensions of the signatures do not add up");
    if (status == 0 && self->test.parts) {
        const int outcome = point_at_parts(self);
        if (outcome < 0)
            PyErr_NoMemory();
        if (outcome == 0)
            PyErr_SetString(PyExc_ValueError, "the sizes of the parts do not add up");
        status = outcome > 0 ? 0 : -1;
        if (self->test.joint != NULL) /* nothing bounds what its directions are judged by: with squares and roots */
            self->naming.are_lines = 0;
    }
    if (status == 0) {
        const Py_ssize_t of_filter = packed_size(self->n, self->m, self->nr);
        const Py_ssize_t packed = of_filter + packed_size(1, self->m, self->n) + 1;
        const Py_ssize_t padded = 24 * self->m + self->test.k * self->naming.room;
        const Py_ssize_t zeros = self->m + self->n + CHUNK;
        self->room = PyMem_Calloc((size_t)(packed + padded + zeros + 7), sizeof(double));
        if (self->room == NULL)
            status = -1, PyErr_NoMemory();
        else {
            self->filter.packed = line_of(self->room);
            self->starter.packed = self->filter.packed + of_filter;
            self->zeros = self->filter.packed + packed + padded;
            self->tile = self->filter.packed + packed;
            point_at_plan(self);
            find_records(self);
            status = pack_filter(self);
        }
    }
    if (status < 0) {
        Py_DECREF(self);
        return NULL;
    }
    return (PyObject *)self;
}

static void
free_scratch(void *room, scratch *s)
{
    free_gain_store(&s->gains);
    free(room);
}

static void
runner_dealloc(PyObject *object)
{
    Runner *self = (Runner *)object;
    PyTypeObject *type = Py_TYPE(object);
    for (int j = 0; j < PLAN_ARRAYS; j++)
        if (self->has_plan[j])
            PyBuffer_Release(&self->plan[j]);
    for (int j = 0; j < STATE_ARRAYS; j++)
        if (self->has_state[j])
            PyBuffer_Release(&self->state[j]);
    while (self->one_views.held > 0)
        PyBuffer_Release(&self->one_views.views[--self->one_views.held]);
    free_scratch(self->one_room, &self->one_scratch);
    free(self->sections);
    PyMem_Free(self->sections_room);
    PyMem_Free(self->parts_room);
    PyMem_Free(self->room);
    freefunc release = (freefunc)PyType_GetSlot(type, Py_tp_free);
    release(object);
    Py_DECREF(type);
}

static Py_ssize_t
small_size(const Runner *self)
{
    const test_plan *t = &self->test;
    const Py_ssize_t judging = 3 * (t->k + t->sums + t->directions + 2) + self->nr + self->naming.columns;
    const Py_ssize_t starting = self->n + self->nr + self->n_ratios;
    return judging + starting + 8;
}

static void *
make_scratch(const Runner *self, scratch *s, Py_ssize_t time)
{
    const Py_ssize_t samples = time < CHUNK ? CHUNK : time < self->span ? time : self->span, k = self->test.k;
    const test_plan *t = &self->test;
    const Py_ssize_t widest = t->directions > k ? t->directions : k;
    const Py_ssize_t room_e = t->kind == NORM || t->kind == PARTS ? 0 : samples * k;
    const Py_ssize_t states = (3 * CHUNK + 3) * (self->n + 1) + 16;
    const int is_summed = t->kind >= CHI_SQUARED && t->kind <= DIRECTED_GLR;
    const Py_ssize_t lanes = t->kind == CROSIER ? (samples / LANES / CHECKED + 1) * LANES * k : 0;
    const Py_ssize_t means = t->kind == MEANS ? samples * ((t->scales + 1) * k + 2) : 0;
    const Py_ssize_t history = is_summed ? widest * (t->window - 1 + samples + 16) : lanes + means;
    const Py_ssize_t parts = samples * t->parts, members = self->naming.kind == CODES ? parts : 0;
    const Py_ssize_t directions = self->naming.kind == DIRECTIONS ? samples * ((LONG_MEANS + 1) * k + 3) : 0;
    const Py_ssize_t columns = parts ? samples * (self->nr + 1) + parts : 0;
    const Py_ssize_t notes = self->lacks_room ? NOTES * (NOTE_HEAD + self->n) : 0;
    const Py_ssize_t doubles = samples * (self->m + self->nr + 3 * k + 2) + states + small_size(self) + room_e + history
                               + parts + 2 * members + columns + directions + 3 * t->parts + t->sums + self->m + notes + 12;
    double *room = malloc((size_t)doubles * sizeof(double) + (size_t)(3 * samples + parts + members + 1));
    memset(&s->gains, 0, sizeof s->gains);
    if (room == NULL || (self->has_gains && !make_gain_store(&s->gains, &self->some))) {
        free_scratch(room, s);
        return NULL;
    }
    s->v = room;
    s->r = s->own_r = s->v + samples * self->m;
    s->q = s->own_r + samples * self->nr + 4; /* ticks store rows as four numbers, however few they have */
    s->sums = s->q + (samples + 8) * k + 4;
    s->statistic = s->sums + samples * k;
    s->up = (whole *)(s->statistic + samples);
    s->x = (double *)(s->up + samples);
    s->starts = s->x + (2 * CHUNK + 3) * (self->n + 1) + 8;
    s->small = s->x + states;
    s->e = s->small + small_size(self);
    s->history = s->e + room_e;
    s->parts.statistics = s->history + history;
    s->parts.ones = s->parts.statistics + parts;
    s->parts.counts = s->parts.ones + members;
    s->parts.columns = s->parts.counts + members;
    s->columns = s->parts.columns + columns;
    s->sample = s->columns + directions;
    s->notes = s->sample + self->m;
    s->stream = s->notes + notes;
    s->runs = (whole *)(s->stream + t->sums);
    s->n_notes = 0;
    s->wants_gains = 0;
    s->usable = (flag *)(room + doubles);
    s->over = s->usable + samples;
    s->alarm = s->over + samples;
    s->parts.fired = s->alarm + samples;
    s->parts.code = s->parts.fired + parts;
    s->filter = self->filter;
    s->filter.state = s->x + 2 * CHUNK * self->n; /* of the start too, which has one state */
    s->filter.q = s->q;
    s->filter.squares = s->statistic;
    s->filter.k = k;
    s->columns_of_q = s->q;
    s->is_within = s->may_be_raw = s->is_raw = 0;
    s->apart = 0;
    s->apart_if_columns = samples + 8;
    return room;
}

/* ---- Python: running --------------------------------------------------------------------------------------------- */

/* An array of (plants, time, channels) with any strides. */
static int
get_signals(PyObject *object, Py_buffer *view, Py_ssize_t plants, Py_ssize_t *time, Py_ssize_t channels)
{
    if (PyObject_GetBuffer(object, view, PyBUF_STRIDES | PyBUF_FORMAT) < 0)
        return -1;
    if (view->ndim == 3 && view->format != NULL && strcmp(view->format, "d") == 0 && view->shape[0] == plants
        && (*time < 0 || view->shape[1] == *time) && view->shape[2] == channels && is_aligned(view)) {
        *time = view->shape[1];
        return 0;
    }
    PyErr_SetString(PyExc_ValueError, "u and y must be aligned float64 of (plants, time, channels)");
    PyBuffer_Release(view);
    return -1;
}

/* An array of (plants, time, ...) whose rows lie one after the other for each plant. */
static int
get_output(PyObject *object, Py_buffer *view, Py_ssize_t plants, Py_ssize_t time, Py_ssize_t width, Py_ssize_t size,
           output *out)
{
    if (PyObject_GetBuffer(object, view, PyBUF_STRIDES | PyBUF_WRITABLE) < 0)
        return -1;
    Py_ssize_t expected = size * width;
    int fits = view->ndim >= 2 && view->itemsize == size && view->shape[0] == plants && view->shape[1] == time;
    if (view->ndim == 3)
        fits = fits && view->shape[2] == width && (view->strides[2] == size || width <= 1);
    else
        fits = fits && width == 1;
    if (fits && (time <= 1 || view->strides[1] == expected) && is_aligned(view)) {
        *out = (output){view->buf, view->strides[0], expected};
        return 0;
    }
    PyErr_SetString(PyExc_ValueError, "an output has another shape, or does not lie as it must");
    PyBuffer_Release(view);
    return -1;
}

static int
get_outputs(const Runner *self, PyObject *outputs, Py_ssize_t plants, block *b, views *all)
{
    const Py_ssize_t widths[OUTPUTS] = {self->nr, 1, self->m, 1, 1, 1, 1, 1, self->test.k, self->naming.groups, 1,
                                         self->test.parts, self->test.parts,
                                         self->naming.kind == CODES ? self->naming.k : 0};
    const Py_ssize_t sizes[OUTPUTS] = {8, 1, 1, 1, 8, 1, 1, 8, 8, 8, 1, 8, 1, 1};
    for (int j = 0; j < OUTPUTS; j++) {
        PyObject *one = PyTuple_GetItem(outputs, j);
        if (one == NULL)
            return -1;
        if (one == Py_None)
            continue;
        if (get_output(one, &all->views[all->held], plants, b->time, widths[j], sizes[j], &b->out[j]) < 0)
            return -1;
        all->held++;
    }
    return 0;
}

static int
check_rows(const Runner *self, const whole *rows, const whole *left, int fresh, Py_ssize_t plants, Py_ssize_t time)
{
    for (Py_ssize_t p = 0; p < plants && (rows != NULL || !fresh); p++)
        if ((rows != NULL && (rows[p] < 0 || rows[p] >= self->plants)) || (!fresh && (left[p] < 0 || left[p] > time))) {
            PyErr_SetString(PyExc_ValueError, "a row or a sample that is not there");
            return -1;
        }
    if (rows == NULL && plants != self->plants) {
        PyErr_SetString(PyExc_ValueError, "another number of plants");
        return -1;
    }
    return 0;
}

/* How many plants stopped for want of room. */
static Py_ssize_t
run_all(const Runner *self, const block *b, const whole *rows, whole *left, int fresh, Py_ssize_t first,
        Py_ssize_t stop, scratch *s)
{
    Py_ssize_t open = 0;
    if (fresh && b->time == 1 && b->joined.base == NULL)
        open = run_tick(self, b, rows, left, first, stop, s);
    else
        for (Py_ssize_t p = first; p < stop; p++) {
            const Py_ssize_t begin = fresh ? 0 : b->time - (Py_ssize_t)left[p];
            const Py_ssize_t end = run_plant(self, b, p, rows == NULL ? p : (Py_ssize_t)rows[p], begin, s);
            if (end < b->time || !fresh)
                left[p] = b->time - end;
            open += end < b->time;
        }
    return open;
}

/* Where a run writes down what it has done: that it has run, how many plants stopped for want of room, whether one did
 * for want of gains, and how many notes there are; and these. */
enum { RAN, STOPPED, WANTS_GAINS, NOTED, RECEIPT };

PyDoc_STRVAR(run_doc, "run(u, y, outputs, rows, left, fresh, first, stop, receipt, notes, joined)\n--\n\n"
                      "Run the last `left` samples of plants first to stop of a block, all of them if it is fresh. `left` "
                      "is then what is left of each; it must be zeros if the block is fresh. In the receipt: 1, how many "
                      "plants stopped on the way, whether one did for want of what a Kalman filter with missing values "
                      "needs, and how many notes there are of what there was no room for. An error leaves all as it was. "
                      "joined is None, or takes u and y side by side, of several samples.");

/* The arrays of a run; 0 if they do not fit, with an error set. */
static int
get_run(const Runner *self, PyObject *const *given, int fresh, Py_ssize_t first, Py_ssize_t stop, block *b, views *all)
{
    enum { U_, Y_, OUTPUTS_, ROWS_, LEFT_, RECEIPT_, NOTES_, JOINED_ };
    Py_buffer *const view = all->views;
    const Py_ssize_t note = NOTES * (NOTE_HEAD + self->n);
    if (PyObject_GetBuffer(given[LEFT_], &view[0], PyBUF_C_CONTIGUOUS | PyBUF_WRITABLE | PyBUF_FORMAT) < 0)
        return 0;
    all->held = 1;
    const Py_ssize_t plants = view[0].len / 8;
    if (view[0].itemsize != 8 || first < 0 || stop < first || stop > plants) {
        PyErr_SetString(PyExc_ValueError, "no such plants");
        return 0;
    }
    if (take(given[RECEIPT_], &view[1], "lq", RECEIPT, 1, "run", 0) < 0)
        return 0;
    all->held = 2;
    if (take(given[NOTES_], &view[2], "d", note, 1, "run", 1) < 0)
        return 0;
    all->held = 3;
    if (get_signals(given[Y_], &view[3], plants, &b->time, self->n_y) < 0)
        return 0;
    all->held = 4;
    if (get_signals(given[U_], &view[4], plants, &b->time, self->n_u) < 0)
        return 0;
    all->held = 5;
    if (given[ROWS_] != Py_None) {
        if (take(given[ROWS_], &view[5], "lq", plants, 0, "rows", 0) < 0)
            return 0;
        all->held = 6;
    }
    b->y = view[3].buf;
    b->u = view[4].buf;
    memcpy(b->y_strides, view[3].strides, sizeof b->y_strides);
    memcpy(b->u_strides, view[4].strides, sizeof b->u_strides);
    b->is_dense = b->u_strides[2] == sizeof(double) && b->y_strides[2] == sizeof(double);
    const whole *const rows = given[ROWS_] == Py_None ? NULL : view[5].buf;
    if (given[JOINED_] != Py_None) {
        if (get_output(given[JOINED_], &view[all->held], plants, b->time, self->m, sizeof(double), &b->joined) < 0)
            return 0;
        all->held++;
    }
    return get_outputs(self, given[OUTPUTS_], plants, b, all) == 0
           && check_rows(self, rows, view[0].buf, fresh, plants, b->time) == 0;
}

static PyObject *
runner_run(PyObject *object, PyObject *args)
{
    const Runner *self = (Runner *)object;
    PyObject *given[8];
    Py_ssize_t first, stop;
    int fresh, has_run = 0;
    if (!PyArg_ParseTuple(args, "OOO!OOpnnOOO:run", &given[0], &given[1], &PyTuple_Type, &given[2], &given[3],
                          &given[4], &fresh, &first, &stop, &given[5], &given[6], &given[7]))
        return NULL;
    views all = {.held = 0};
    block b = {.time = -1};
    if (get_run(self, given, fresh, first, stop, &b, &all)) {
        scratch s;
        void *room = make_scratch(self, &s, b.time);
        if (room == NULL)
            PyErr_NoMemory();
        else {
            const whole *const rows = given[3] == Py_None ? NULL : all.views[5].buf;
            whole *const receipt = all.views[1].buf;
            Py_BEGIN_ALLOW_THREADS
            receipt[STOPPED] = run_all(self, &b, rows, all.views[0].buf, fresh, first, stop, &s);
            receipt[WANTS_GAINS] = s.wants_gains;
            receipt[NOTED] = s.n_notes;
            memcpy(all.views[2].buf, s.notes, (size_t)(s.n_notes * (NOTE_HEAD + self->n)) * sizeof(double));
            receipt[RAN] = 1;
            Py_END_ALLOW_THREADS
            free_scratch(room, &s);
            has_run = 1;
        }
    }
    while (all.held > 0)
        PyBuffer_Release(&all.views[--all.held]);
    if (!has_run)
        return NULL;
    Py_RETURN_NONE;
}

PyDoc_STRVAR(bind_doc, "bind(outputs)\n--\n\nName the arrays that steps write, of one plant and one sample.");

static PyObject *
runner_bind(PyObject *object, PyObject *outputs)
{
    Runner *self = (Runner *)object;
    if (self->plants != 1 || self->lacks_room || self->one_room != NULL || !PyTuple_Check(outputs)) {
        PyErr_SetString(PyExc_ValueError, "steps are of one plant, and bound once to a tuple of arrays");
        return NULL;
    }
    self->one.time = 1;
    self->one.is_used = 1;
    if (get_outputs(self, outputs, 1, &self->one, &self->one_views) < 0)
        return NULL;
    for (int j = 0; j < OUTPUTS; j++)
        if (self->one.out[j].base == NULL
            && (j == OUT_STATISTIC || j == OUT_USABLE || j == OUT_ALARM || j == OUT_MISSING)) {
            PyErr_SetString(PyExc_ValueError, "an output that a step needs is None");
            return NULL;
        }
    self->one_room = make_scratch(self, &self->one_scratch, 1);
    if (self->one_room == NULL)
        return PyErr_NoMemory();
    Py_RETURN_NONE;
}

/* One sample; None where there are no channels. */
static int
get_sample(PyObject *object, Py_buffer *view, Py_ssize_t channels, const char **at, Py_ssize_t *stride)
{
    *at = NULL;
    *stride = sizeof(double);
    if (object == Py_None && channels == 0)
        return 0;
    if (PyObject_GetBuffer(object, view, PyBUF_STRIDES | PyBUF_FORMAT) < 0)
        return -1;
    if (view->ndim == 1 && view->format != NULL && strcmp(view->format, "d") == 0 && view->shape[0] == channels
        && is_aligned(view)) {
        *at = view->buf;
        *stride = view->strides[0];
        return 1;
    }
    PyErr_SetString(PyExc_ValueError, "a sample must be aligned float64 of as many channels as there are");
    PyBuffer_Release(view);
    return -1;
}

PyDoc_STRVAR(step_doc, "step(u, y)\n--\n\n"
                       "Run one sample; 1 alarm, 2 usable, 4 missing, 8 stopped for want of room; the statistic.");

static PyObject *
runner_step(PyObject *object, PyObject *args)
{
    Runner *self = (Runner *)object;
    PyObject *u, *y;
    Py_buffer u_view, y_view;
    block *b = &self->one;
    if (!PyArg_ParseTuple(args, "OO:step", &u, &y))
        return NULL;
    if (self->one_room == NULL) {
        PyErr_SetString(PyExc_ValueError, "bind comes before step");
        return NULL;
    }
    const int has_u = get_sample(u, &u_view, self->n_u, &b->u, &b->u_strides[2]);
    if (has_u < 0)
        return NULL;
    const int has_y = get_sample(y, &y_view, self->n_y, &b->y, &b->y_strides[2]);
    if (has_y < 0) {
        if (has_u)
            PyBuffer_Release(&u_view);
        return NULL;
    }
    b->is_dense = b->u_strides[2] == sizeof(double) && b->y_strides[2] == sizeof(double);
    const int left = run_plant(self, b, 0, 0, 0, &self->one_scratch) == 0;
    const int flags = (*out_b1(b, OUT_ALARM, 0, 0) ? 1 : 0) | (*out_b1(b, OUT_USABLE, 0, 0) ? 2 : 0)
                      | (*out_b1(b, OUT_MISSING, 0, 0) ? 4 : 0) | (left ? 8 : 0);
    if (has_u)
        PyBuffer_Release(&u_view);
    if (has_y)
        PyBuffer_Release(&y_view);
    return Py_BuildValue("id", flags, *out_f8(b, OUT_STATISTIC, 0, 0));
}

static PyMethodDef runner_methods[] = {
    {"bind", runner_bind, METH_O, bind_doc},
    {"step", runner_step, METH_VARARGS, step_doc},
    {"run", runner_run, METH_VARARGS, run_doc},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot runner_slots[] = {
    {Py_tp_new, runner_new},
    {Py_tp_dealloc, runner_dealloc},
    {Py_tp_methods, runner_methods},
    {Py_tp_doc, "Runner(integers, numbers, plan, state, plants, path)\n--\n\nRuns plants, whose state it changes."},
    {0, NULL},
};

static PyType_Spec runner_spec = {
    .name = "residua.monitor._fused.Runner",
    .basicsize = sizeof(Runner),
    .flags = Py_TPFLAGS_DEFAULT,
    .slots = runner_slots,
};

static int
fill_module(PyObject *module)
{
    PyObject *type = PyType_FromSpec(&runner_spec);
    if (type == NULL)
        return -1;
    const int status = PyModule_AddObjectRef(module, "Runner", type);
    Py_DECREF(type);
    return status;
}

DEFINE_MODULE(_fused, "residua.monitor._fused", "The compiled loop of residua.monitor.fused.", NULL,
              FILLED_BY(fill_module))
