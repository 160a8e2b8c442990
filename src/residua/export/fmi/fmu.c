/*
 * What the functions of FMI have in common: one instance, its variables and its steps.
 */
#include "PREFIX_fmu.h"
#include <float.h>
#include <math.h>

/* How exactly a communication point has to meet a sample, in seconds. */
static const double within = PREFIX_DT / 1000.0;
/* Samples in one step, at most; and between time zero and the start. */
static const double most_samples = 1.0e9;
static const double most_before = 1.0e12;

void PREFIX_fmu_reset(PREFIX_memory *memory)
{
    static const double inputs[PREFIX_CHANNELS] = PREFIX_START;
    static const PREFIX_memory rest = {0};
    uint32_t k;
    *memory = rest;
    PREFIX_init(&memory->state);
    for (k = 0U; k < PREFIX_CHANNELS; k++) {
        memory->inputs[k] = inputs[k];
    }
    memory->mode = PREFIX_INSTANTIATED;
}

bool PREFIX_fmu_start(PREFIX_memory *memory, double time)
{
    const bool possible = fabs(time) <= (most_before * PREFIX_DT);
    if (possible) {
        memory->time = time;
        memory->next = time;
    }
    return possible;
}

/* Take a sample of the inputs as they are. */
static void take(PREFIX_memory *memory)
{
    PREFIX_step(&memory->state, memory->inputs, &memory->inputs[PREFIX_INPUT_COUNT], &memory->decision);
}

const char *PREFIX_fmu_step(PREFIX_memory *memory, double time, double size)
{
    const double end = time + size;
    const bool due = memory->next <= (time + within);
    const double following = due ? (time + PREFIX_DT) : memory->next;
    const char *refused = NULL;
    if (!((size >= 0.0) && (fabs(end) <= (most_before * PREFIX_DT)) && (size <= (most_samples * PREFIX_DT)))) {
        refused = "the communication step is negative, no number, or holds more than a billion samples";
    } else if (!(fabs(time - memory->time) <= within)) {
        refused = "the communication point is not where the last step ended";
    } else if ((following < (end - within)) && !memory->hold_inputs) {
        refused = "a sample falls inside of the communication step, and its inputs are not known: samples are "
                  PREFIX_DT_TEXT " s apart from the start on, so take steps of that size, or of a whole part of it, "
                  "or set hold_inputs to take such samples with the inputs of the beginning of the step";
    } else {
        if (due && (size > 0.0)) {
            take(memory);
            memory->next = following;
        }
        while (memory->next < (end - within)) {
            take(memory);
            memory->next += PREFIX_DT;
        }
        memory->time = end;
    }
    return refused;
}

bool PREFIX_fmu_get_real(const PREFIX_memory *memory, uint32_t reference, double *value)
{
    bool there = true;
    if (reference == PREFIX_TIME) {
        *value = memory->time;
    } else if (reference < PREFIX_STATISTIC) {
        *value = memory->inputs[reference - PREFIX_FIRST_INPUT];
    } else if (reference == PREFIX_STATISTIC) {
        *value = memory->decision.statistic;
    } else if (reference == PREFIX_THRESHOLD_REFERENCE) {
        *value = PREFIX_THRESHOLD;
    } else if (reference < PREFIX_FIRST_SCORE) {
        *value = memory->decision.residual[reference - PREFIX_FIRST_RESIDUAL];
#if PREFIX_SCORES > 0
    } else if (reference < PREFIX_FIRST_PART) {
        *value = memory->decision.score[reference - PREFIX_FIRST_SCORE];
#endif
#if PREFIX_PARTS > 0
    } else if (reference < PREFIX_FIRST_FLAG) {
        *value = memory->decision.part_statistic[reference - PREFIX_FIRST_PART];
#endif
    } else {
        there = false;
    }
    return there;
}

bool PREFIX_fmu_get_flag(const PREFIX_memory *memory, uint32_t reference, bool *value)
{
    bool there = true;
    if (reference == PREFIX_KNOWN) {
        *value = memory->decision.known;
    } else if (reference == PREFIX_DECIDED) {
        *value = memory->decision.decided;
    } else if (reference == PREFIX_ALARM) {
        *value = memory->decision.alarm;
    } else if (reference == PREFIX_HOLD_INPUTS) {
        *value = memory->hold_inputs;
#if PREFIX_PARTS > 0
    } else if ((reference >= PREFIX_FIRST_FIRED) && (reference < PREFIX_FIRST_CODE)) {
        *value = memory->decision.fired[reference - PREFIX_FIRST_FIRED];
#endif
#if PREFIX_CODED_PARTS > 0
    } else if ((reference >= PREFIX_FIRST_CODE) && (reference < PREFIX_SCORED)) {
        *value = memory->decision.code[reference - PREFIX_FIRST_CODE];
#endif
#if PREFIX_SCORES > 0
    } else if (reference == PREFIX_SCORED) {
        *value = memory->decision.scored;
#endif
    } else {
        there = false;
    }
    return there;
}

bool PREFIX_fmu_get_count(const PREFIX_memory *memory, uint32_t reference, int32_t *value)
{
    bool there = false;
#if PREFIX_SCORES > 0
    if (reference == PREFIX_BEST) {
        *value = memory->decision.best;
        there = true;
    }
#if PREFIX_CODED_PARTS > 0
    if (reference == PREFIX_ANSWER) {
        *value = memory->decision.answer;
        there = true;
    }
#endif
#else
    (void)memory;
    (void)reference;
    (void)value;
#endif
    return there;
}

bool PREFIX_fmu_set_real(PREFIX_memory *memory, uint32_t reference, double value)
{
    const bool settable =
        (reference >= PREFIX_FIRST_INPUT) && (reference < PREFIX_STATISTIC) && (memory->mode != PREFIX_TERMINATED);
    if (settable) {
        memory->inputs[reference - PREFIX_FIRST_INPUT] = value;
    }
    return settable;
}

bool PREFIX_fmu_set_flag(PREFIX_memory *memory, uint32_t reference, bool value)
{
    const bool before = (memory->mode == PREFIX_INSTANTIATED) || (memory->mode == PREFIX_INITIALIZING);
    const bool settable = (reference == PREFIX_HOLD_INPUTS) && before;
    if (settable) {
        memory->hold_inputs = value;
    }
    return settable;
}

/* Write a number as eight bytes, the least first. */
static void put(uint64_t number, uint8_t bytes[])
{
    uint64_t rest = number;
    uint32_t k;
    for (k = 0U; k < 8U; k++) {
        bytes[k] = (uint8_t)(rest & 0xFFU);
        rest >>= 8U;
    }
}

/* Copy all that an instance remembers. */
static void copy(const uint8_t from[], uint8_t to[])
{
    size_t k;
    for (k = 0U; k < sizeof(PREFIX_memory); k++) {
        to[k] = from[k];
    }
}

/* The sum of Fowler, Noll and Vo over bytes. */
static uint64_t sum_of(const uint8_t bytes[], size_t size)
{
    uint64_t sum = 0xCBF29CE484222325U;
    size_t k;
    for (k = 0U; k < size; k++) {
        sum = (sum ^ bytes[k]) * 1099511628211U;
    }
    return sum;
}

void PREFIX_fmu_serialize(const PREFIX_memory *memory, uint8_t bytes[])
{
    copy((const uint8_t *)memory, &bytes[16]);
    put(PREFIX_FINGERPRINT, &bytes[0]);
    put(sum_of(&bytes[16], sizeof(PREFIX_memory)), &bytes[8]);
}

bool PREFIX_fmu_deserialize(const uint8_t bytes[], size_t size, PREFIX_memory *memory)
{
    uint8_t begun[16];
    bool same = size == PREFIX_SERIALIZED_SIZE;
    uint32_t k;
    if (same) {
        put(PREFIX_FINGERPRINT, &begun[0]);
        put(sum_of(&bytes[16], sizeof(PREFIX_memory)), &begun[8]);
        for (k = 0U; k < 16U; k++) {
            same = same && (bytes[k] == begun[k]);
        }
    }
    if (same) {
        copy(&bytes[16], (uint8_t *)memory);
    }
    return same;
}
