/* How a compiled module of the package is defined. */
#ifndef RESIDUA_MODULE_H
#define RESIDUA_MODULE_H

#include <stdint.h>

#if defined(Py_mod_gil) && !defined(Py_LIMITED_API)
#define WITHOUT_GLOBAL_LOCK {Py_mod_gil, Py_MOD_GIL_NOT_USED},
#else
#define WITHOUT_GLOBAL_LOCK
#endif

/* Whether the numbers of an array, no wider than eight bytes, begin where they may be read. */
static inline int
is_aligned(const Py_buffer *view)
{
    const uintptr_t size = (uintptr_t)view->itemsize;
    uintptr_t places = (uintptr_t)view->buf;
    if (size == 0 || view->len == 0)
        return 1;
    for (int d = 0; d < view->ndim && view->strides != NULL; d++)
        places |= view->shape[d] > 1 ? (uintptr_t)view->strides[d] : 0;
    return places % size == 0;
}

#define FILLED_BY(function) {Py_mod_exec, function},

/* FILLED: FILLED_BY(a function that adds to the new module), or nothing. */
#define DEFINE_MODULE(NAME, WHOLE_NAME, DOC, METHODS, FILLED)                                                         \
    static PyModuleDef_Slot module_slots[] = {FILLED WITHOUT_GLOBAL_LOCK{0, NULL}};                                   \
    static struct PyModuleDef module_definition = {                                                                   \
        PyModuleDef_HEAD_INIT,                                                                                        \
        .m_name = WHOLE_NAME,                                                                                         \
        .m_doc = DOC,                                                                                                 \
        .m_size = 0,                                                                                                  \
        .m_methods = METHODS,                                                                                         \
        .m_slots = module_slots,                                                                                      \
    };                                                                                                                \
    PyMODINIT_FUNC PyInit_##NAME(void) { return PyModuleDef_Init(&module_definition); }

#endif
