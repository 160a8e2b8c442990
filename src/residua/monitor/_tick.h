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
    Py_ssize_t stop, open; /* the end of all plants; those that are left to NumPy */
    int is_short; /* whether a norm without a window, of records, and nothing but what a tick tells is asked for */
} tick;

INLINE Py_ssize_t
row_in_tick(const tick *t, Py_ssize_t plant)
{
    return t->rows == NULL ? plant : (Py_ssize_t)t->rows[plant];
}

/* The states of plants, one after the other; how many of them are an ordinary case. */
static Py_ssize_t
gather_states(const Runner *self, const tick *t, Py_ssize_t first, Py_ssize_t count, double *x)
{
    Py_ssize_t plain = 0;
    for (Py_ssize_t i = first; i < first + count; i++) {
        const Py_ssize_t row = row_in_tick(t, i);
        plain += *B1(self, RUNNING, row) & !*B1(self, STARTING, row) & !(self->partial && *B1(self, APART, row));
        x = copy_few(x, PLACE(self, X, row), self->n);
    }
    return plain;
}

/* The same of records, which are listed, while those of the next chunk are on their way. */
INLINE Py_ssize_t
gather_records(const Runner *self, const tick *t, Py_ssize_t first, Py_ssize_t count, double *x, char **records)
{
    const Py_ssize_t n = self->n, stride = self->stride[COUNT], size = self->record_size;
    const Py_ssize_t begin = self->offset[X], running = self->offset[RUNNING], starting = self->offset[STARTING];
    const Py_ssize_t apart = self->offset[APART];
    const flag partial = self->partial != 0;
    Py_ssize_t plain = 0;
    for (Py_ssize_t i = 0; i < count; i++) {
        char *const record = self->records + row_in_tick(t, first + i) * stride;
        if (first + i + CHUNK < t->stop) {
            const char *next = self->records + row_in_tick(t, first + i + CHUNK) * stride;
            for (Py_ssize_t k = 0; k < size; k += 64)
                PREFETCH(next + k);
        }
        records[i] = record;
        plain += *(flag *)(record + running) & !*(flag *)(record + starting)
                 & !(partial && *(flag *)(record + apart));
        x = copy_few(x, record + begin, n);
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

#define LOCAL(which) const Py_ssize_t at_##which = self->offset[which] /* a store of a flag does not make it be read again */
#define OF_RECORD(type, which) (*(type *)(record + at_##which))

/* A norm without a window of records: decided, and what a tick tells written. */
INLINE void
finish_records(const Runner *self, const tick *t, Py_ssize_t first, Py_ssize_t count, char *const *records,
               const double *x, const scratch *s)
{
    const test_plan *const test = &self->test;
    const Py_ssize_t n = self->n, m = self->m, nr = self->nr;
    const double threshold = test->threshold, *const statistics = s->statistic, *const r = s->own_r;
    const whole settle = self->settle, persistence = test->persistence, release = test->release;
    const source in = s->in;
    const output usables = t->b->out[OUT_USABLE], alarms = t->b->out[OUT_ALARM], told = t->b->out[OUT_STATISTIC];
    const int keeps = self->has_state[LAST_FLAGS];
    LOCAL(X);
    LOCAL(HELD);
    LOCAL(AGE);
    LOCAL(GAP);
    LOCAL(COUNT);
    LOCAL(UP);
    LOCAL(DOWN);
    LOCAL(ALARM);
    LOCAL(LAST_FLAGS);
    LOCAL(LAST_STATISTIC);
    LOCAL(LAST_UP);
    LOCAL(LAST_RESIDUALS);
    for (Py_ssize_t i = 0; i < count; i++) {
        char *const record = records[i];
        const whole age = ++OF_RECORD(whole, AGE);
        const int usable = age > settle, over = usable & (statistics[i] > threshold);
        whole up = OF_RECORD(whole, UP), down = OF_RECORD(whole, DOWN);
        flag alarm = OF_RECORD(flag, ALARM);
        OF_RECORD(whole, GAP) = 0;
        OF_RECORD(whole, COUNT) += 1;
        if (usable) {
            up = (up + 1) & -(whole)over;
            down = (down + 1) & ((whole)over - 1);
            const int ends = !over & (down >= release), begins = over & (up >= persistence);
            alarm = (flag)((alarm & !ends) | begins);
        }
        OF_RECORD(whole, UP) = up;
        OF_RECORD(whole, DOWN) = down;
        OF_RECORD(flag, ALARM) = alarm;
        const double statistic = usable ? statistics[i] : NAN;
        copy_few(&OF_RECORD(double, X), (const char *)(x + i * n), n);
        copy_sample(&OF_RECORD(double, HELD), &in, i, m);
        *(flag *)(usables.base + (first + i) * usables.plant) = (flag)usable;
        *(flag *)(alarms.base + (first + i) * alarms.plant) = alarm;
        *(double *)(told.base + (first + i) * told.plant) = statistic;
        if (keeps) {
            OF_RECORD(flag, LAST_FLAGS) = (flag)(alarm | usable << 1);
            OF_RECORD(double, LAST_STATISTIC) = statistic;
            OF_RECORD(whole, LAST_UP) = up;
            copy_few(&OF_RECORD(double, LAST_RESIDUALS), (const char *)(r + i * nr), nr);
        }
    }
}

/* Any other test or isolation, plant by plant. */
static void
finish_each(const Runner *self, const tick *t, Py_ssize_t first, Py_ssize_t count, const double *x, scratch *s)
{
    double *const r = s->own_r, *const white = s->q, *const squares = s->statistic;
    for (Py_ssize_t i = 0; i < count; i++) {
        const Py_ssize_t row = row_in_tick(t, first + i);
        s->usable[0] = (flag)keep_filter(self, row, &s->in, i, x + i * self->n);
        s->is_missing = 0;
        s->r = r + i * self->nr;
        s->q = white + i * self->test.k;
        s->statistic = squares + i;
        s->count = *I8(self, COUNT, row) - 1;
        if (t->b->out[OUT_RESIDUALS].base != NULL)
            copy_doubles(out_f8(t->b, OUT_RESIDUALS, first + i, 0), s->r, self->nr);
        judge(self, t->b, first + i, row, 0, 1, s);
    }
    s->q = white;
    s->statistic = squares;
}

INLINE int
together(const Runner *self, const tick *t, Py_ssize_t first, Py_ssize_t count, scratch *s)
{
    const block *b = t->b;
    const Py_ssize_t n = self->n;
    const char *u = b->u + first * b->u_strides[0], *y = b->y + first * b->y_strides[0];
    double *const x = s->x, *const x_next = x + CHUNK * n;
    char *records[CHUNK];
    const Py_ssize_t plain = self->record_size ? gather_records(self, t, first, count, x, records)
                                        : gather_states(self, t, first, count, x);
    if (plain == 0) /* such as at the first sample */
        return -1;
    if (plain < count || !gather(self, b, u, y, b->u_strides[0], b->y_strides[0], count, s))
        return 0;
    job *q = &s->filter;
    q->plants = count;
    q->time = 1;
    q->x = x;
    q->x_next = x_next;
    q->v = s->in;
    q->r = s->own_r;
    q->judge = self->judge;
    s->is_short = 0;
    s->is_judged = execute(q, self->path);
    if (!all_within(s->own_r, count * self->nr, LARGEST) || !all_within(x_next, count * n, DBL_MAX))
        return 0;
    if (t->is_short && s->is_judged && all_within(s->statistic, count, LARGEST_SQUARES)) {
        roots(s->statistic, count);
        finish_records(self, t, first, count, records, x_next, s);
    } else
        finish_each(self, t, first, count, x_next, s);
    return 1;
}

static int
together_plain(const Runner *self, const tick *t, Py_ssize_t first, Py_ssize_t count, scratch *s)
{
    return together(self, t, first, count, s);
}

#if defined(HAVE_AVX2)
AVX2 static int
together_avx2(const Runner *self, const tick *t, Py_ssize_t first, Py_ssize_t count, scratch *s)
{
    return together(self, t, first, count, s);
}
#endif

/* Some plants that are an ordinary case; 0, and nothing done, if they are not, and -1 if no one is. */
static int
run_together(const Runner *self, const tick *t, Py_ssize_t first, Py_ssize_t count, scratch *s)
{
#if defined(HAVE_AVX2)
    if (self->path == PATH_AVX2)
        return together_avx2(self, t, first, count, s);
#endif
    return together_plain(self, t, first, count, s);
}

static void
run_in_tick(const Runner *self, tick *t, Py_ssize_t first, Py_ssize_t count, scratch *s)
{
    const int outcome = run_together(self, t, first, count, s);
    if (outcome == 1)
        return;
    if (outcome == 0 && count > 1) {
        run_in_tick(self, t, first, count / 2, s);
        run_in_tick(self, t, first + count / 2, count - count / 2, s);
        return;
    }
    for (Py_ssize_t i = first; i < first + count; i++)
        if (run_plant(self, t->b, i, row_in_tick(t, i), 0, s) == 0) {
            t->left[i] = 1;
            t->open++;
        }
}

/* Run one sample of plants first to stop; how many are left to NumPy. */
static Py_ssize_t
run_tick(const Runner *self, const block *b, const whole *rows, whole *left, Py_ssize_t first, Py_ssize_t stop,
         scratch *s)
{
    tick t = {b, rows, left, stop, 0, 0};
    t.is_short = self->record_size && self->test.kind == NORM && self->test.window == 1 && self->naming.kind == NOBODY;
    for (int j = 0; j < OUTPUTS; j++) {
        const int told = j == OUT_USABLE || j == OUT_ALARM || j == OUT_STATISTIC;
        t.is_short &= told ? b->out[j].base != NULL : j == OUT_MISSING || b->out[j].base == NULL;
    }
    for (Py_ssize_t p = first; p < stop; p += CHUNK)
        run_in_tick(self, &t, p, stop - p < CHUNK ? stop - p : CHUNK, s);
    return t.open;
}

#endif
