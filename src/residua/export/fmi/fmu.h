/*
 * What the functions of FMI have in common: one instance, its variables and its steps.
 */
#ifndef PREFIX_FMU_H
#define PREFIX_FMU_H

#include "PREFIX_model.h"
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Real variables in the order of their references, from 0 on; flags and counts follow. */
#define PREFIX_TIME 0U
#define PREFIX_FIRST_INPUT 1U
#define PREFIX_STATISTIC (PREFIX_FIRST_INPUT + PREFIX_CHANNELS)
#define PREFIX_THRESHOLD_REFERENCE (PREFIX_STATISTIC + 1U)
#define PREFIX_FIRST_RESIDUAL (PREFIX_STATISTIC + 2U)
#define PREFIX_FIRST_SCORE (PREFIX_FIRST_RESIDUAL + PREFIX_RESIDUALS)
#define PREFIX_FIRST_PART (PREFIX_FIRST_SCORE + PREFIX_SCORES)
#define PREFIX_FIRST_FLAG (PREFIX_FIRST_PART + PREFIX_PARTS)
#define PREFIX_KNOWN PREFIX_FIRST_FLAG
#define PREFIX_DECIDED (PREFIX_FIRST_FLAG + 1U)
#define PREFIX_ALARM (PREFIX_FIRST_FLAG + 2U)
#define PREFIX_HOLD_INPUTS (PREFIX_FIRST_FLAG + 3U)
#define PREFIX_FIRST_FIRED (PREFIX_FIRST_FLAG + 4U)
#define PREFIX_FIRST_CODE (PREFIX_FIRST_FIRED + PREFIX_PARTS)
#define PREFIX_SCORED (PREFIX_FIRST_CODE + PREFIX_CODED_PARTS)
#define PREFIX_BEST (PREFIX_SCORED + 1U)
#define PREFIX_ANSWER (PREFIX_SCORED + 2U)

/* Where an instance stands. */
typedef enum { PREFIX_INSTANTIATED, PREFIX_INITIALIZING, PREFIX_STEPPING, PREFIX_TERMINATED } PREFIX_mode;

/* All that an instance remembers: what getting and setting its state copies. */
typedef struct {
    PREFIX_state state;
    PREFIX_decision decision;
    double inputs[PREFIX_CHANNELS];
    double time; /* where the last step ended */
    double next; /* when the next sample is due */
    PREFIX_mode mode;
    bool hold_inputs; /* whether samples inside of a step have the inputs of its beginning */
} PREFIX_memory;

/* Bytes in front of a serialised state: of which monitor it is, and a check sum. */
#define PREFIX_SERIALIZED_SIZE (16U + sizeof(PREFIX_memory))

/* As before initialisation. */
void PREFIX_fmu_reset(PREFIX_memory *memory);

/* The time of the first sample; whether it can be told from those that follow. */
bool PREFIX_fmu_start(PREFIX_memory *memory, double time);

/* One communication step; NULL, or why it is refused, with nothing changed. */
const char *PREFIX_fmu_step(PREFIX_memory *memory, double time, double size);

/* Variables by their references; whether there is such a one, and it may be set now. */
bool PREFIX_fmu_get_real(const PREFIX_memory *memory, uint32_t reference, double *value);
bool PREFIX_fmu_get_flag(const PREFIX_memory *memory, uint32_t reference, bool *value);
bool PREFIX_fmu_get_count(const PREFIX_memory *memory, uint32_t reference, int32_t *value);
bool PREFIX_fmu_set_real(PREFIX_memory *memory, uint32_t reference, double value);
bool PREFIX_fmu_set_flag(PREFIX_memory *memory, uint32_t reference, bool value);

/* The state as bytes; whether bytes are a state of this very monitor. */
void PREFIX_fmu_serialize(const PREFIX_memory *memory, uint8_t bytes[]);
bool PREFIX_fmu_deserialize(const uint8_t bytes[], size_t size, PREFIX_memory *memory);

#endif
