/* The running kernel of residua.linear.systems.recursion: filters over the data of many plants; see _filter.h. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "../../_module.h"
#include "_filter.h"

/* ---- Python --------------------------------------------------------------------------------------------------- */

#define ARRAYS 9
enum { A_, B_, C_, D_, X_, V_, X_NEXT, R_, W_ }; /* the last one is optional */
static const char *const names[ARRAYS] = {"A", "B", "C", "D", "x", "v", "x_next", "r", "w"};
static const int dimensions[ARRAYS] = {2, 2, 2, 2, 2, 3, 2, 3, 3};

/* One C-contiguous array of native doubles; the shape is checked by the caller. */
static int
get_array(PyObject *object, Py_buffer *view, int index)
{
    const int writable = index == X_NEXT || index == R_ ? PyBUF_WRITABLE : 0;
    if (PyObject_GetBuffer(object, view, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | writable) < 0)
        return -1;
    if (view->ndim == dimensions[index] && view->format != NULL && strcmp(view->format, "d") == 0 && is_aligned(view))
        return 0;
    PyErr_Format(PyExc_TypeError, "%s must be an aligned C-contiguous array of float64 with %d dimensions", names[index],
                 dimensions[index]);
    PyBuffer_Release(view);
    return -1;
}

static int
has_shape(const Py_buffer *view, int index, Py_ssize_t a, Py_ssize_t b, Py_ssize_t c)
{
    const Py_ssize_t *s = view->shape;
    if (s[0] == a && s[1] == b && (view->ndim == 2 || s[2] == c))
        return 1;
    PyErr_Format(PyExc_ValueError, "%s has a shape that does not fit the other arrays", names[index]);
    return 0;
}

static int
shapes_fit(const Py_buffer *b, const job *q, int has_w)
{
    const Py_ssize_t others = q->m - q->v.columns;
    return has_shape(&b[A_], A_, q->n, q->n, 0) && has_shape(&b[B_], B_, q->n, q->m, 0)
           && has_shape(&b[C_], C_, q->nr, q->n, 0) && has_shape(&b[D_], D_, q->nr, q->m, 0)
           && has_shape(&b[X_], X_, q->plants, q->n, 0) && has_shape(&b[V_], V_, q->plants, q->time, q->v.columns)
           && has_shape(&b[X_NEXT], X_NEXT, q->plants, q->n, 0) && has_shape(&b[R_], R_, q->plants, q->time, q->nr)
           && (!has_w || has_shape(&b[W_], W_, q->plants, q->time, others));
}

static int
run_on_buffers(Py_buffer *b, int has_w, int path)
{
    job q = {.n = b[B_].shape[0], .m = b[B_].shape[1], .nr = b[C_].shape[0], .plants = b[V_].shape[0],
             .time = b[V_].shape[1], .A = b[A_].buf, .B = b[B_].buf, .C = b[C_].buf, .D = b[D_].buf, .x = b[X_].buf,
             .x_next = b[X_NEXT].buf, .r = b[R_].buf};
    const Py_ssize_t others = has_w ? b[W_].shape[2] : 0;
    q.v = (source){b[V_].buf, has_w ? b[W_].buf : b[V_].buf, q.m - others, q.m - others, others};
    if (!shapes_fit(b, &q, has_w))
        return -1;
    const Py_ssize_t padded = q.n + q.nr + 2 * BLOCK;
    if (q.n + q.m > (PY_SSIZE_T_MAX / (Py_ssize_t)sizeof(double) - 3 * q.n) / 2 / padded) {
        PyErr_NoMemory();
        return -1;
    }
    as_a_whole(&q);
    Py_ssize_t size = padded * (q.n + q.m) + 3 * q.n;
    section *const sections = find_sections(&q, &q.n_sections, &size);
    double *room = PyMem_Malloc((size_t)(size + 16) * sizeof(double));
    if (room == NULL) {
        free(sections);
        PyErr_NoMemory();
        return -1;
    }
    q.packed = line_of(room);
    q.state = q.packed + padded * (q.n + q.m);
    place_sections(sections, q.n_sections, q.m, line_of(q.state + 3 * q.n));
    q.sections = sections;
    Py_BEGIN_ALLOW_THREADS
    pack_sections(&q, path);
    execute(&q, path);
    Py_END_ALLOW_THREADS
    free(sections);
    PyMem_Free(room);
    return 0;
}

PyDoc_STRVAR(run_doc, "run(A, B, C, D, x, v, x_next, r, path, w=None)\n--\n\n"
                      "Fill x_next and r; the inputs are the columns of v and then those of w. path: 0 plain C, 1 baseline vectors, 2 AVX2; no more than best_path().");

static PyObject *
run(PyObject *module, PyObject *args)
{
    (void)module;
    PyObject *o[ARRAYS];
    Py_buffer views[ARRAYS];
    int path, held = 0, status = -1;
    o[W_] = NULL;
    if (!PyArg_ParseTuple(args, "OOOOOOOOi|O:run", &o[0], &o[1], &o[2], &o[3], &o[4], &o[5], &o[6], &o[7], &path,
                          &o[W_]))
        return NULL;
    if (path < PATH_PLAIN || path > best_path()) {
        PyErr_SetString(PyExc_ValueError, "this processor or build does not have that path");
        return NULL;
    }
    const int has_w = o[W_] != NULL, arrays = has_w ? ARRAYS : W_;
    while (held < arrays && get_array(o[held], &views[held], held) == 0)
        held++;
    if (held == arrays)
        status = run_on_buffers(views, has_w, path);
    while (held > 0)
        PyBuffer_Release(&views[--held]);
    if (status < 0)
        return NULL;
    Py_RETURN_NONE;
}

static PyObject *
get_best_path(PyObject *module, PyObject *unused)
{
    (void)module;
    (void)unused;
    return PyLong_FromLong(best_path());
}

static PyMethodDef methods[] = {
    {"run", run, METH_VARARGS, run_doc},
    {"best_path", get_best_path, METH_NOARGS, "best_path()\n--\n\nThe fastest path that this processor has."},
    {NULL, NULL, 0, NULL},
};

DEFINE_MODULE(_recursion, "residua.linear.systems._recursion",
              "The compiled kernel of residua.linear.systems.recursion.", methods, )
