/* The running kernel of residua.linear.systems.recursion: filters over the data of many plants; see _filter.h. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "_filter.h"

/* ---- Python --------------------------------------------------------------------------------------------------- */

#define ARRAYS 8
static const char *const names[ARRAYS] = {"A", "B", "C", "D", "x", "v", "x_next", "r"};
static const int dimensions[ARRAYS] = {2, 2, 2, 2, 2, 3, 2, 3};

/* One C-contiguous array of native doubles; the shape is checked by the caller. */
static int
get_array(PyObject *object, Py_buffer *view, int index)
{
    const int writable = index >= 6 ? PyBUF_WRITABLE : 0;
    if (PyObject_GetBuffer(object, view, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | writable) < 0)
        return -1;
    if (view->ndim == dimensions[index] && view->format != NULL && strcmp(view->format, "d") == 0)
        return 0;
    PyErr_Format(PyExc_TypeError, "%s must be a C-contiguous array of float64 with %d dimensions", names[index],
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
shapes_fit(const Py_buffer *b, const job *q)
{
    return has_shape(&b[0], 0, q->n, q->n, 0) && has_shape(&b[1], 1, q->n, q->m, 0)
           && has_shape(&b[2], 2, q->nr, q->n, 0) && has_shape(&b[3], 3, q->nr, q->m, 0)
           && has_shape(&b[4], 4, q->plants, q->n, 0) && has_shape(&b[5], 5, q->plants, q->time, q->m)
           && has_shape(&b[6], 6, q->plants, q->n, 0) && has_shape(&b[7], 7, q->plants, q->time, q->nr);
}

static int
run_on_buffers(Py_buffer *b, int path)
{
    job q = {.n = b[1].shape[0], .m = b[1].shape[1], .nr = b[2].shape[0], .plants = b[5].shape[0],
             .time = b[5].shape[1], .A = b[0].buf, .B = b[1].buf, .C = b[2].buf, .D = b[3].buf, .x = b[4].buf,
             .v = one_array(b[5].buf, b[1].shape[1]), .x_next = b[6].buf, .r = b[7].buf};
    if (!shapes_fit(b, &q))
        return -1;
    const Py_ssize_t padded = q.n + q.nr + 2 * BLOCK;
    if (q.n + q.m > (PY_SSIZE_T_MAX / (Py_ssize_t)sizeof(double) - 2 * q.n) / padded) {
        PyErr_NoMemory();
        return -1;
    }
    double *room = PyMem_Malloc((size_t)(padded * (q.n + q.m) + 2 * q.n + 8) * sizeof(double));
    if (room == NULL) {
        PyErr_NoMemory();
        return -1;
    }
    q.packed = line_of(room);
    q.state = q.packed + padded * (q.n + q.m);
    Py_BEGIN_ALLOW_THREADS
    execute(&q, path);
    Py_END_ALLOW_THREADS
    PyMem_Free(room);
    return 0;
}

PyDoc_STRVAR(run_doc, "run(A, B, C, D, x, v, x_next, r, path)\n--\n\n"
                      "Fill x_next and r. path: 0 plain C, 1 baseline vectors, 2 AVX2; no more than best_path().");

static PyObject *
run(PyObject *module, PyObject *args)
{
    (void)module;
    PyObject *o[ARRAYS];
    Py_buffer views[ARRAYS];
    int path, held = 0, status = -1;
    if (!PyArg_ParseTuple(args, "OOOOOOOOi:run", &o[0], &o[1], &o[2], &o[3], &o[4], &o[5], &o[6], &o[7], &path))
        return NULL;
    if (path < PATH_PLAIN || path > best_path()) {
        PyErr_SetString(PyExc_ValueError, "this processor or build does not have that path");
        return NULL;
    }
    while (held < ARRAYS && get_array(o[held], &views[held], held) == 0)
        held++;
    if (held == ARRAYS)
        status = run_on_buffers(views, path);
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

static PyModuleDef_Slot slots[] = {
#if defined(Py_mod_gil) && !defined(Py_LIMITED_API)
    {Py_mod_gil, Py_MOD_GIL_NOT_USED},
#endif
    {0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT,
    .m_name = "residua.linear.systems._recursion",
    .m_doc = "The compiled kernel of residua.linear.systems.recursion.",
    .m_size = 0,
    .m_methods = methods,
    .m_slots = slots,
};

PyMODINIT_FUNC
PyInit__recursion(void)
{
    return PyModuleDef_Init(&definition);
}
