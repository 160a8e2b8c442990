/* One sample of many plants. The same bits as plant by plant.
 *
 * A few plants at once go through each step, so that processors work on several while others wait for memory. Those
 * that are another case, since a value is missing or their filter overflows, are left out of what is written, and then
 * run as recordings of one sample.
 */
#ifndef RESIDUA_TICK_H
#define RESIDUA_TICK_H

#define CHUNK 32 /* plants; at least two */
#define ODD 32   /* plants: code and predictions of branches stay those of one road for a while */

#if defined(__GNUC__)
#define PREFETCH(at) __builtin_prefetch(at, 1)
#else
#define PREFETCH(at) (void)(at)
#endif

typedef struct {
    const block *b;
    const whole *rows; /* of the state; NULL for all in order */
    whole *left;
    Py_ssize_t stop, open; /* the end of all plants; those that are left */
    int is_short; /* whether a norm without a window, of records, and nothing but what a tick tells is asked for */
    int is_early; /* whether a plant of the last chunk has just started */
    Py_ssize_t n_odd, odd[ODD]; /* plants that are another case, which are run by themselves some at a time */
} tick;

/* Some plants of a tick that go through it together. */
typedef struct {
    Py_ssize_t first, count;
    int is_fresh, is_early;      /* whether a filter does not run yet; whether one has just started, or does so now */
    int has_apart;               /* whether a Kalman filter is off its stationary one */
    int has_odd;                 /* whether there are some that are run by themselves afterwards */
    flag is_odd[CHUNK];          /* which */
    char *records[CHUNK];
} chunk;

INLINE Py_ssize_t
row_in_tick(const tick *t, Py_ssize_t plant)
{
    return t->rows == NULL ? plant : (Py_ssize_t)t->rows[plant];
}

/* The states of plants, one after the other. */
static void
gather_states(const Runner *self, const tick *t, chunk *c, double *x)
{
    flag running = 1, starting = 0, apart = 0;
    for (Py_ssize_t i = 0; i < c->count; i++) {
        const Py_ssize_t row = row_in_tick(t, c->first + i);
        running &= *B1(self, RUNNING, row);
        starting |= *B1(self, STARTING, row);
        apart |= *B1(self, APART, row);
        x = copy_few(x, PLACE(self, X, row), self->n);
    }
    c->is_fresh = !running;
    c->is_early = starting;
    c->has_apart = self->partial && apart;
}

/* The same of records, which are listed, while those of the next chunk are on their way. */
INLINE void
gather_records(const Runner *self, const tick *t, chunk *c, double *x)
{
    const Py_ssize_t n = self->n, stride = self->stride[COUNT], size = self->record_size, first = c->first;
    const Py_ssize_t begin = self->offset[X], running = self->offset[RUNNING], starting = self->offset[STARTING];
    const Py_ssize_t apart = self->offset[APART], count = c->count, ahead = t->stop - CHUNK - first;
    const int is_early = t->is_early && self->has_starts;
    flag all_running = 1, any_starting = 0, any_apart = 0;
    for (Py_ssize_t i = 0; i < count; i++) {
        char *const record = self->records + row_in_tick(t, first + i) * stride;
        if (i < ahead) {
            const Py_ssize_t row = row_in_tick(t, first + i + CHUNK);
            const char *next = self->records + row * stride;
            for (Py_ssize_t k = 0; k < size; k += 64)
                PREFETCH(next + k);
            if (is_early)
                PREFETCH(PLACE(self, START_SUMS, row));
        }
        c->records[i] = record;
        all_running &= *(flag *)(record + running);
        any_starting |= *(flag *)(record + starting);
        any_apart |= *(flag *)(record + apart);
        x = copy_few(x, record + begin, n);
    }
    c->is_fresh = !all_running;
    c->is_early = any_starting;
    c->has_apart = self->partial && any_apart;
}

#define FOUR 4 /* samples that a tile has of each limit */

/* Mark the plants of a chunk that are off their stationary filter, and those that miss a value unless `all` are there. */
static void
mark_odd(const Runner *self, const tick *t, chunk *c, const source *in, int all)
{
    const double *low = PLAN(self, LOW), *high = PLAN(self, HIGH);
    const Py_ssize_t m = self->m, columns = in->columns, others = m - columns;
    const double *const tile = others ? self->tile + 12 * m : self->tile, *const next = tile + 12 * columns;
    c->has_odd = 1;
    for (Py_ssize_t i = 0; i < c->count; i++)
        c->is_odd[i] = c->has_apart && *B1(self, APART, row_in_tick(t, c->first + i));
    for (Py_ssize_t i = 0; i < c->count && !all; i += FOUR) {
        const Py_ssize_t rows = c->count - i < FOUR ? c->count - i : FOUR;
        if (deviations(self, in->first + i * in->first_step, NULL, rows, tile, columns)
            && deviations(self, in->second + i * in->second_step, NULL, rows, next, others))
            continue;
        for (Py_ssize_t k = i; k < i + rows; k++)
            for (Py_ssize_t j = 0; j < m; j++) {
                const double value = deviation(in, k, j);
                c->is_odd[k] |= !((value >= low[j]) & (value <= high[j]));
            }
    }
    int is_fresh = 0; /* a filter that waits for a whole sample does not start */
    for (Py_ssize_t i = 0; i < c->count && c->is_fresh; i++)
        is_fresh |= !c->is_odd[i] && !*B1(self, RUNNING, row_in_tick(t, c->first + i));
    c->is_fresh = is_fresh;
}

/* Mark those whose filters start or have just started, where there is no room for what their residuals say of it. */
static void
mark_starts(const Runner *self, const tick *t, chunk *c)
{
    if (!c->has_odd)
        memset(c->is_odd, 0, sizeof c->is_odd);
    for (Py_ssize_t i = 0; i < c->count; i++) {
        const Py_ssize_t row = row_in_tick(t, c->first + i);
        c->is_odd[i] |= !*B1(self, RUNNING, row) || *B1(self, STARTING, row);
    }
    c->has_odd = 1;
    c->is_fresh = c->is_early = 0;
}

/* The first plant from one on that is another case; the number of plants if there is none. */
INLINE Py_ssize_t
next_odd(const chunk *c, Py_ssize_t from)
{
    const flag *at = c->has_odd ? memchr(c->is_odd + from, 1, (size_t)(c->count - from)) : NULL;
    return at == NULL ? c->count : at - c->is_odd;
}

/* The states that filters start with which do not run yet. */
static void
start_together(const Runner *self, const tick *t, const chunk *c, const scratch *s, double *x)
{
    const Py_ssize_t n = self->n;
    job q = self->starter;
    q.plants = c->count;
    q.v = s->in;
    q.x_next = s->starts + CHUNK * n;
    q.r = s->starts;
    q.state = s->filter.state;
    execute(&q, self->path);
    for (Py_ssize_t i = 0; i < c->count; i++)
        if (!*B1(self, RUNNING, row_in_tick(t, c->first + i)))
            copy_doubles(x + i * n, s->starts + i * n, n);
}

/* What is remembered of filters that start or have just started, before their sample is counted. */
static void
learn_together(const Runner *self, const tick *t, const chunk *c, double *x, scratch *s)
{
    const Py_ssize_t n = self->n;
    for (Py_ssize_t i = 0; i < c->count; i++) {
        const Py_ssize_t row = row_in_tick(t, c->first + i);
        if (c->has_odd && c->is_odd[i])
            continue;
        const int is_fresh = !*B1(self, RUNNING, row);
        if (is_fresh) {
            *B1(self, RUNNING, row) = 1;
            *B1(self, STARTING, row) = self->first > 0;
            *I4(self, AGE, row) = 0;
        }
        if (!*B1(self, STARTING, row))
            continue;
        s->seldom.start_sums = F8(self, START_SUMS, row);
        s->seldom.moved = F8(self, MOVED, row);
        if (is_fresh)
            memset(s->seldom.start_sums, 0, (size_t)n * sizeof(double));
        learn_start(self, row, s->own_r + i * self->nr, 1, s);
        if ((whole)*I4(self, AGE, row) + 1 == self->first) {
            copy_doubles(F8(self, X, row), x + i * n, n);
            correct_start(self, row, s);
            copy_doubles(x + i * n, F8(self, X, row), n);
        }
    }
}

/* Whether no plant of a chunk overflows; what is there of those that are another case is not looked at, and cleared. */
INLINE int
are_all_sound(const Runner *self, const chunk *c, double *r, double *x)
{
    for (Py_ssize_t i = next_odd(c, 0); i < c->count; i = next_odd(c, i + 1)) {
        clear_doubles(r + i * self->nr, self->nr);
        clear_doubles(x + i * self->n, self->n);
    }
    return all_within(r, c->count * self->nr, LARGEST) && all_within(x, c->count * self->n, DBL_MAX);
}

/* Mark the plants of a chunk that overflow. */
static void
mark_overflows(const Runner *self, chunk *c, const double *r, const double *x)
{
    for (Py_ssize_t i = 0; i < c->count; i++)
        c->is_odd[i] = (c->has_odd && c->is_odd[i]) || !all_within(r + i * self->nr, self->nr, LARGEST)
                       || !is_finite(x + i * self->n, self->n);
    c->has_odd = 1;
}

/* What is remembered of a plant after an ordinary sample; whether the filter has settled. */
INLINE int
keep_filter(const Runner *self, Py_ssize_t row, const source *in, Py_ssize_t i, const double *x)
{
    const counter age = stopped((whole)*I4(self, AGE, row) + 1);
    copy_few(F8(self, X, row), (const char *)x, self->n);
    copy_sample(F8(self, HELD, row), in, i, self->held);
    *I4(self, AGE, row) = age;
    *I4(self, GAP, row) = 0;
    *I8(self, COUNT, row) += 1;
    return age > self->settle;
}

#define LOCAL(which) const Py_ssize_t at_##which = self->offset[which] /* a store of a flag does not make it be read again */
#define OF_RECORD(type, which) (*(type *)(record + at_##which))

/* A norm without a window of records: decided, and what a tick tells written. */
INLINE void
finish_records(const Runner *self, const tick *t, const chunk *c, const double *x, const scratch *s)
{
    const Py_ssize_t first = c->first, count = c->count;
    const test_plan *const test = &self->test;
    const Py_ssize_t n = self->n, held = self->held, nr = self->nr;
    const double threshold = test->threshold, *const statistics = s->statistic, *const r = s->own_r;
    const whole settle = self->settle, persistence = test->persistence, release = test->release;
    const source in = s->in;
    const output usables = t->b->out[OUT_USABLE], alarms = t->b->out[OUT_ALARM], told = t->b->out[OUT_STATISTIC];
    const int keeps = self->has_state[LAST_FLAGS], has_odd = c->has_odd;
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
        char *const record = c->records[i];
        if (has_odd && c->is_odd[i])
            continue;
        const counter age = stopped((whole)OF_RECORD(counter, AGE) + 1);
        const int usable = age > settle, over = usable & (statistics[i] > threshold);
        counter up = OF_RECORD(counter, UP), down = OF_RECORD(counter, DOWN);
        flag alarm = OF_RECORD(flag, ALARM);
        OF_RECORD(counter, AGE) = age;
        OF_RECORD(counter, GAP) = 0;
        OF_RECORD(whole, COUNT) += 1;
        if (usable) {
            up = (up + (up < INT32_MAX)) & -(counter)over;
            down = (down + (down < INT32_MAX)) & ((counter)over - 1);
            const int ends = !over & (down >= release), begins = over & (up >= persistence);
            alarm = (flag)((alarm & !ends) | begins);
        }
        OF_RECORD(counter, UP) = up;
        OF_RECORD(counter, DOWN) = down;
        OF_RECORD(flag, ALARM) = alarm;
        const double statistic = usable ? statistics[i] : NAN;
        copy_few(&OF_RECORD(double, X), (const char *)(x + i * n), n);
        copy_sample(&OF_RECORD(double, HELD), &in, i, held);
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
finish_each(const Runner *self, const tick *t, const chunk *c, const double *x, scratch *s)
{
    double *const r = s->own_r, *const white = s->q, *const squares = s->statistic;
    for (Py_ssize_t i = 0; i < c->count; i++) {
        if (c->has_odd && c->is_odd[i])
            continue;
        const Py_ssize_t plant = c->first + i, row = row_in_tick(t, plant);
        s->usable[0] = (flag)keep_filter(self, row, &s->in, i, x + i * self->n);
        s->is_missing = 0;
        s->r = r + i * self->nr;
        s->q = white + i * self->test.k;
        s->statistic = squares + i;
        s->count = *I8(self, COUNT, row) - 1;
        if (t->b->out[OUT_RESIDUALS].base != NULL)
            copy_doubles(out_f8(t->b, OUT_RESIDUALS, plant, 0), s->r, self->nr);
        judge(self, t->b, plant, row, 0, 1, s);
    }
    s->q = white;
    s->statistic = squares;
}

/* Run the plants of a chunk that are no other case, and say which are. */
INLINE void
together(const Runner *self, tick *t, chunk *c, scratch *s)
{
    const block *b = t->b;
    const Py_ssize_t n = self->n, count = c->count;
    const char *u = b->u + c->first * b->u_strides[0], *y = b->y + c->first * b->y_strides[0];
    double *const x = s->x, *const x_next = x + CHUNK * n;
    if (self->record_size)
        gather_records(self, t, c, x);
    else
        gather_states(self, t, c, x);
    const int all = gather(self, b, u, y, b->u_strides[0], b->y_strides[0], count, 0, s);
    c->has_odd = 0;
    if (!all || c->has_apart)
        mark_odd(self, t, c, &s->in, all);
    if ((c->is_fresh || c->is_early) && self->first && !self->has_starts)
        mark_starts(self, t, c);
    if (c->is_fresh)
        start_together(self, t, c, s, x);
    job *q = &s->filter;
    q->plants = count;
    q->time = 1;
    q->x = x;
    q->x_next = x_next;
    q->v = s->in;
    q->r = s->own_r;
    q->judge = self->judge;
    s->is_short = s->is_within = 0;
    s->apart = 0;
    s->is_judged = execute(q, self->path);
    if (!are_all_sound(self, c, s->own_r, x_next))
        mark_overflows(self, c, s->own_r, x_next);
    t->is_early = c->is_fresh || c->is_early;
    if (t->is_early)
        learn_together(self, t, c, x_next, s);
    for (Py_ssize_t i = next_odd(c, 0); i < count; i = next_odd(c, i + 1))
        s->statistic[i] = 0.0;
    if (t->is_short && s->is_judged && all_within(s->statistic, count, LARGEST_SQUARES)) {
        roots(s->statistic, count);
        finish_records(self, t, c, x_next, s);
    } else
        finish_each(self, t, c, x_next, s);
}

static void
together_plain(const Runner *self, tick *t, chunk *c, scratch *s)
{
    together(self, t, c, s);
}

#if defined(HAVE_AVX2)
AVX2 static void
together_avx2(const Runner *self, tick *t, chunk *c, scratch *s)
{
    together(self, t, c, s);
}
#endif

/* Run the plants that are another case. */
static void
run_odd(const Runner *self, tick *t, scratch *s)
{
    for (Py_ssize_t k = 0; k < t->n_odd; k++) {
        const Py_ssize_t plant = t->odd[k];
        if (run_plant(self, t->b, plant, row_in_tick(t, plant), 0, s) == 0) {
            t->left[plant] = 1;
            t->open++;
        }
    }
    t->n_odd = 0;
}

static void
run_in_tick(const Runner *self, tick *t, Py_ssize_t first, Py_ssize_t count, scratch *s)
{
    chunk c;
    c.first = first;
    c.count = count;
#if defined(HAVE_AVX2)
    if (self->path == PATH_AVX2)
        together_avx2(self, t, &c, s);
    else
#endif
        together_plain(self, t, &c, s);
    for (Py_ssize_t i = next_odd(&c, 0); i < count; i = next_odd(&c, i + 1)) {
        t->odd[t->n_odd++] = first + i;
        if (t->n_odd == ODD)
            run_odd(self, t, s);
    }
}

/* Run one sample of plants first to stop; how many stopped for want of room. */
static Py_ssize_t
run_tick(const Runner *self, const block *b, const whole *rows, whole *left, Py_ssize_t first, Py_ssize_t stop,
         scratch *s)
{
    tick t = {.b = b, .rows = rows, .left = left, .stop = stop};
    t.is_short = self->record_size && self->test.kind == NORM && self->test.window == 1 && self->naming.kind == NOBODY;
    for (int j = 0; j < OUTPUTS; j++) {
        const int told = j == OUT_USABLE || j == OUT_ALARM || j == OUT_STATISTIC;
        t.is_short &= told ? b->out[j].base != NULL : j == OUT_MISSING || b->out[j].base == NULL;
    }
    for (Py_ssize_t p = first; p < stop; p += CHUNK)
        run_in_tick(self, &t, p, stop - p < CHUNK ? stop - p : CHUNK, s);
    run_odd(self, &t, s);
    return t.open;
}

#endif
