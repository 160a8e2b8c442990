/* One sample of many plants, as most are: their filters run, and no value is missing. The same bits as plant by plant.
 *
 * A few plants at once go through each step, so that processors work on several while others wait for memory. A chunk
 * in which one plant is another case is cut in two, and so on; what is left is run as a recording of one sample.
 */
#ifndef RESIDUA_TICK_H
#define RESIDUA_TICK_H

#define CHUNK 32 /* plants; at least two */

#if defined(__GNUC__)
#define PREFETCH(at) __builtin_prefetch(at, 1)
#else
#define PREFETCH(at) (void)(at)
#endif

typedef struct {
    const block *b;
    const whole *rows; /* of the state; NULL for all in order */
    whole *left;
    Py_ssize_t open; /* plants that are left to NumPy */
    int is_short;    /* whether a norm without a window, and nothing but what a tick tells of it, is asked for */
} tick;

INLINE Py_ssize_t
row_in_tick(const tick *t, Py_ssize_t plant)
{
    return t->rows == NULL ? plant : (Py_ssize_t)t->rows[plant];
}

/* Ask for what is remembered of a plant, which lies side by side. */
INLINE void
prefetch_plant(const Runner *self, Py_ssize_t row)
{
    const char *at = self->lowest + row * self->stride[COUNT];
    for (Py_ssize_t i = 0; i < self->near; i += 64)
        PREFETCH(at + i);
}

/* The states of plants, one after the other; whether all are an ordinary case. */
INLINE int
gather_states(const Runner *self, const tick *t, Py_ssize_t first, Py_ssize_t count, Py_ssize_t stop, double *x)
{
    const Py_ssize_t n = self->n;
    int plain = 1;
    for (Py_ssize_t i = first; i < first + count; i++) {
        const Py_ssize_t row = row_in_tick(t, i);
        if (i + CHUNK < stop)
            prefetch_plant(self, row_in_tick(t, i + CHUNK));
        plain &= *B1(self, RUNNING, row) & !*B1(self, STARTING, row);
        if (self->partial)
            plain &= !*B1(self, APART, row);
        x = copy_few(x, PLACE(self, X, row), n);
    }
    return plain;
}

/* What is remembered of a plant after an ordinary sample; whether the filter has settled. */
INLINE int
keep_filter(const Runner *self, Py_ssize_t row, const source *in, Py_ssize_t i, const double *x)
{
    const whole age = *I8(self, AGE, row) + 1;
    copy_few(F8(self, X, row), (const char *)x, self->n);
    copy_sample(F8(self, HELD, row), in, i, self->m);
    *I8(self, AGE, row) = age;
    *I8(self, GAP, row) = 0;
    *I8(self, COUNT, row) += 1;
    return age > self->settle;
}

/* A norm without a window: decided, and what a tick tells written. */
INLINE void
judge_short(const Runner *self, const tick *t, Py_ssize_t plant, Py_ssize_t row, int usable, double statistic,
            const double *r)
{
    const test_plan *test = &self->test;
    whole up = *I8(self, UP, row), down = *I8(self, DOWN, row);
    flag alarm = *B1(self, ALARM, row);
    if (usable) {
        const int over = statistic > test->threshold;
        up = over ? up + 1 : 0;
        down = over ? 0 : down + 1;
        alarm = (over ? up >= test->persistence : down >= test->release) ? (flag)over : alarm;
        *I8(self, UP, row) = up;
        *I8(self, DOWN, row) = down;
        *B1(self, ALARM, row) = alarm;
    }
    statistic = usable ? statistic : NAN;
    *out_b1(t->b, OUT_USABLE, plant, 0) = (flag)usable;
    *out_b1(t->b, OUT_ALARM, plant, 0) = alarm;
    *out_f8(t->b, OUT_STATISTIC, plant, 0) = statistic;
    if (self->has_state[LAST_FLAGS]) {
        *B1(self, LAST_FLAGS, row) = (flag)((alarm ? 1 : 0) | (usable ? 2 : 0));
        *F8(self, LAST_STATISTIC, row) = statistic;
        *I8(self, LAST_UP, row) = up;
        copy_doubles(F8(self, LAST_RESIDUALS, row), r, self->nr);
    }
}

/* Some plants that are an ordinary case; 0, and nothing done, if they are not. */
static int
run_together(const Runner *self, const tick *t, Py_ssize_t first, Py_ssize_t count, Py_ssize_t stop, scratch *s)
{
    const block *b = t->b;
    const Py_ssize_t n = self->n, nr = self->nr, k = self->test.k;
    double *const x = s->x, *const x_next = x + CHUNK * n;
    const int plain = gather_states(self, t, first, count, stop, x);
    const char *u = b->u + first * b->u_strides[0], *y = b->y + first * b->y_strides[0];
    if (!plain || !gather(self, b, u, y, b->u_strides[0], b->y_strides[0], count, s))
        return 0;
    job *q = &s->filter;
    q->plants = count;
    q->time = 1;
    q->x = x;
    q->x_next = x_next;
    q->v = s->in;
    q->r = s->own_r;
    q->judge = self->judge;
    s->is_judged = execute(q, self->path);
    if (!all_within(s->own_r, count * nr, LARGEST) || !all_within(x_next, count * n, DBL_MAX))
        return 0;
    if (t->is_short && s->is_judged && all_within(s->statistic, count, LARGEST_SQUARES)) {
        roots(s->statistic, count);
        for (Py_ssize_t i = 0; i < count; i++) {
            const Py_ssize_t row = row_in_tick(t, first + i);
            const int usable = keep_filter(self, row, &s->in, i, x_next + i * n);
            judge_short(self, t, first + i, row, usable, s->statistic[i], s->own_r + i * nr);
        }
        return 1;
    }
    double *const r = s->own_r, *const white = s->q, *const squares = s->statistic;
    for (Py_ssize_t i = 0; i < count; i++) {
        const Py_ssize_t row = row_in_tick(t, first + i);
        s->usable[0] = (flag)keep_filter(self, row, &s->in, i, x_next + i * n);
        s->is_missing = 0;
        s->r = r + i * nr;
        s->q = white + i * k;
        s->statistic = squares + i;
        if (b->out[OUT_RESIDUALS].base != NULL)
            copy_doubles(out_f8(b, OUT_RESIDUALS, first + i, 0), s->r, nr);
        judge(self, b, first + i, row, 0, 1, s);
    }
    s->q = white;
    s->statistic = squares;
    return 1;
}

static void
run_in_tick(const Runner *self, tick *t, Py_ssize_t first, Py_ssize_t count, Py_ssize_t stop, scratch *s)
{
    if (run_together(self, t, first, count, stop, s))
        return;
    if (count > 1) {
        run_in_tick(self, t, first, count / 2, stop, s);
        run_in_tick(self, t, first + count / 2, count - count / 2, stop, s);
        return;
    }
    if (run_plant(self, t->b, first, row_in_tick(t, first), 0, s) == 0) {
        t->left[first] = 1;
        t->open++;
    }
}

/* Run one sample of plants first to stop; how many are left to NumPy. */
static Py_ssize_t
run_tick(const Runner *self, const block *b, const whole *rows, whole *left, Py_ssize_t first, Py_ssize_t stop,
         scratch *s)
{
    tick t = {b, rows, left, 0, 0};
    t.is_short = self->test.kind == NORM && self->test.window == 1 && !self->naming.groups;
    for (int j = 0; j < OUTPUTS; j++) {
        const int told = j == OUT_USABLE || j == OUT_ALARM || j == OUT_STATISTIC;
        t.is_short &= told ? b->out[j].base != NULL : j == OUT_MISSING || b->out[j].base == NULL;
    }
    for (Py_ssize_t p = first; p < stop; p += CHUNK)
        run_in_tick(self, &t, p, stop - p < CHUNK ? stop - p : CHUNK, stop, s);
    return t.open;
}

#endif
