/* Rows of numbers, as a reader of JSON returns them, into an array: a type test and a copy for each number. */

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "../_module.h"
#include <math.h>

enum { DONE, NO_ROW, NO_NUMBER };

/* Write one number, NaN for None; truth values and texts are none. */
static int
write_number(PyObject *value, double *out)
{
    if (Py_IS_TYPE(value, &PyFloat_Type)) {
        *out = PyFloat_AsDouble(value);
    }
    else if (value == Py_None) {
        *out = NAN;
    }
    else if (Py_IS_TYPE(value, &PyLong_Type)) {
        *out = PyLong_AsDouble(value);
        if (*out == -1.0 && PyErr_Occurred()) { /* larger than any double */
            PyErr_Clear();
            return NO_NUMBER;
        }
    }
    else {
        return NO_NUMBER;
    }
    return DONE;
}

static int
write_rows(PyObject *rows, Py_ssize_t count, Py_ssize_t width, double *out, Py_ssize_t channels)
{
    if (!PyList_Check(rows) || PyList_Size(rows) != count)
        return NO_ROW;
    for (Py_ssize_t k = 0; k < count; k++, out += channels) {
        PyObject *row = PyList_GetItem(rows, k);
        if (!PyList_Check(row) || PyList_Size(row) != width)
            return NO_ROW;
        for (Py_ssize_t c = 0; c < width; c++) {
            int code = write_number(PyList_GetItem(row, c), out + c);
            if (code != DONE)
                return code;
        }
    }
    return DONE;
}

PyDoc_STRVAR(fill_doc, "fill(values, rows, first, width)\n--\n\n"
                       "Write rows of width numbers into an array from a channel on; 1: a row has not this width, or is\n"
                       "none; 2: a value is no number.");

static PyObject *
fill(PyObject *module, PyObject *args)
{
    (void)module;
    PyObject *array, *rows;
    Py_ssize_t first, width;
    Py_buffer view;
    if (!PyArg_ParseTuple(args, "OOnn:fill", &array, &rows, &first, &width))
        return NULL;
    if (PyObject_GetBuffer(array, &view, PyBUF_C_CONTIGUOUS | PyBUF_WRITABLE | PyBUF_FORMAT) < 0)
        return NULL;
    PyObject *result = NULL;
    if (view.ndim != 2 || view.itemsize != (Py_ssize_t)sizeof(double) || view.format[0] != 'd' || first < 0 ||
        width < 0 || width > view.shape[1] - first)
        PyErr_SetString(PyExc_ValueError, "values must be an array of doubles, (rows, channels), with room for the rows");
    else
        result = PyLong_FromLong(write_rows(rows, view.shape[0], width, (double *)view.buf + first, view.shape[1]));
    PyBuffer_Release(&view);
    return result;
}

static PyMethodDef methods[] = {
    {"fill", fill, METH_VARARGS, fill_doc},
    {NULL, NULL, 0, NULL},
};

DEFINE_MODULE(_rows, "residua.live._rows", "The compiled part of residua.live.readings.", methods, )
