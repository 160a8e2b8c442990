/* A bank of exponentially weighted means, as residua.decide.multiscale_ewma has it, with the same bits. */
#ifndef RESIDUA_MEANS_H
#define RESIDUA_MEANS_H

#define SMALLEST_MEAN 3.054936363499605e-151 /* 2^-500, as in residua.linear.systems.recursion */

/* The square of the longest mean of a part after one sample, of its columns from `begin` on; no long mean grows beyond
 * its full length. `e` and `means` are those of all `width` columns. */
INLINE double
longest_mean(const test_plan *t, double *means, const double *e, Py_ssize_t which, Py_ssize_t begin, Py_ssize_t k,
             Py_ssize_t width)
{
    const double square = square_of(e + begin, k), clip = t->clips[which], most = t->fulls[which];
    const double factor = square > clip * clip ? clip / sqrt(square) : 1.0, full = most * most;
    double largest = 0.0;
    for (Py_ssize_t s = 0; s < t->scales; s++) {
        double *mean = means + (s - 1) * width + begin;
        const double *now = s ? mean : e + begin, *scaling = t->scaling + (s * width + begin) * width + begin;
        const double new_weight = t->mean_weights[s], old_weight = 1.0 - new_weight;
        for (Py_ssize_t j = 0; j < k && s; j++)
            mean[j] = old_weight * mean[j] + new_weight * (e[begin + j] * factor);
        if (s && square == 0.0 && all_within(e + begin, k, 0.0))
            for (Py_ssize_t j = 0; j < k; j++)
                mean[j] = fabs(mean[j]) < SMALLEST_MEAN ? 0.0 : mean[j];
        double length = 0.0;
        for (Py_ssize_t c = 0; c < k; c++) {
            double sum = 0.0;
            for (Py_ssize_t j = 0; j < k; j++)
                sum += now[j] * scaling[j * width + c];
            length += sum * sum;
        }
        if (s && length > full) {
            const double left = most / sqrt(length);
            for (Py_ssize_t j = 0; j < k; j++)
                mean[j] *= left;
            length = full;
        }
        largest = length > largest ? length : largest;
    }
    return largest;
}

/* The squares of scaled means whose components lie in columns, so far apart; the larger of them and of what is there. */
INLINE void
larger_squares(const double *columns, Py_ssize_t apart, Py_ssize_t time, const double *scaling, double *restrict largest,
               Py_ssize_t k)
{
    double weight[16];
    for (Py_ssize_t j = 0; j < k * k; j++)
        weight[j] = scaling[j];
    for (Py_ssize_t i = 0; i < time; i++) {
        double total = 0.0;
        UNROLLED for (Py_ssize_t c = 0; c < k; c++) {
            double sum = 0.0;
            UNROLLED for (Py_ssize_t j = 0; j < k; j++)
                sum += columns[j * apart + i] * weight[j * k + c];
            total += sum * sum;
        }
        largest[i] = total > largest[i] ? total : largest[i];
    }
}

#define MOST_SLOW 3 /* long means of a piece that is run at once */

/* Long means of samples that lie in columns, after each sample; they come into columns behind these. */
INLINE void
follow_means(double *now, const double *olds, const double *weights, double *restrict columns, Py_ssize_t time,
             Py_ssize_t slow, Py_ssize_t k)
{
    for (Py_ssize_t i = 0; i < time; i++)
        UNROLLED for (Py_ssize_t s = 0; s < slow; s++)
            UNROLLED for (Py_ssize_t j = 0; j < k; j++) {
                now[s * k + j] = olds[s] * now[s * k + j] + weights[s] * columns[j * time + i];
                columns[((s + 1) * k + j) * time + i] = now[s * k + j];
            }
}

/* The same of a piece in which all samples are seen and no mean is full, all samples at once; 0, and nothing is changed,
 * where one is. `squares` are those of the samples, which lie in columns. */
INLINE int
means_of_piece(const test_plan *t, double *means, const piece *p, const double *e, Py_ssize_t apart,
               const double *squares, double *room, Py_ssize_t k)
{
    const Py_ssize_t time = p->time, slow = t->scales - 1;
    double *restrict const longest = room, *restrict const columns = longest + time;
    const double clip = t->clips[0], full = t->fulls[0];
    double least = INFINITY, now[4 * MOST_SLOW], weights[MOST_SLOW], olds[MOST_SLOW];
    for (Py_ssize_t i = 0; i < time; i++)
        least = squares[i] < least ? squares[i] : least;
    if (!(least > 0.0))
        return 0;
    for (Py_ssize_t i = 0; i < time; i++)
        longest[i] = squares[i] > clip * clip ? clip / sqrt(squares[i]) : 1.0;
    for (Py_ssize_t j = 0; j < k; j++)
        for (Py_ssize_t i = 0; i < time; i++)
            columns[j * time + i] = e[j * apart + i] * longest[i];
    for (Py_ssize_t j = 0; j < slow * k; j++)
        now[j] = means[j];
    for (Py_ssize_t s = 0; s < slow; s++) {
        weights[s] = t->mean_weights[s + 1];
        olds[s] = 1.0 - weights[s];
    }
    if (slow == 2) /* as a rule */
        follow_means(now, olds, weights, columns, time, 2, k);
    else
        follow_means(now, olds, weights, columns, time, slow, k);
    for (Py_ssize_t i = 0; i < time; i++)
        longest[i] = 0.0;
    for (Py_ssize_t s = 0; s < slow; s++)
        larger_squares(columns + (s + 1) * k * time, time, time, t->scaling + (s + 1) * k * k, longest, k);
    if (!(largest_of(longest, time) <= full * full))
        return 0;
    larger_squares(e, apart, time, t->scaling, longest, k);
    for (Py_ssize_t i = 0; i < time; i++)
        p->statistic[i] = longest[i];
    for (Py_ssize_t j = 0; j < slow * k; j++)
        means[j] = now[j];
    return 1;
}

/* Samples into columns, and their squares. */
INLINE void
into_columns(const double *e, Py_ssize_t time, double *restrict columns, double *restrict squares, Py_ssize_t k)
{
    for (Py_ssize_t i = 0; i < time; i++) {
        double square = 0.0;
        for (Py_ssize_t j = 0; j < k; j++) {
            columns[j * time + i] = e[i * k + j];
            square += e[i * k + j] * e[i * k + j];
        }
        squares[i] = square;
    }
}

/* The longest mean after each sample of a piece; residuals lie in columns where they are `apart`. */
INLINE void
longest_means(const test_plan *t, double *means, const piece *p, Py_ssize_t k)
{
    const Py_ssize_t time = p->time;
    double *const columns = p->history, *const squares = columns + k * time, *const room = squares + time;
    int done = 0;
    if (FEW(k) && time >= 8 && t->scales - 1 <= MOST_SLOW && all_set(p->usable, time)) {
        if (!p->apart)
            into_columns(p->e, time, columns, squares, k);
        done = means_of_piece(t, means, p, p->apart ? p->q : columns, p->apart ? p->apart : time,
                              p->apart ? p->statistic : squares, room, k);
    }
    for (Py_ssize_t i = 0; i < time && !done; i++) {
        const double *e = p->e + i * k;
        double one[4];
        if (p->apart) {
            for (Py_ssize_t j = 0; j < k; j++)
                one[j] = p->q[j * p->apart + i];
            e = one;
        }
        p->statistic[i] = p->usable[i] ? longest_mean(t, means, e, 0, 0, k, k) : 0.0;
    }
    roots(p->statistic, time);
}

#endif
