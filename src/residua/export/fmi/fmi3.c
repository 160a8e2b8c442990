/*
 * The functions of FMI 3.0 for co-simulation; those of other interfaces are there, and refuse.
 */
#include "fmi3Functions.h"
#include "PREFIX_fmu.h"
#include <stdlib.h>
#include <string.h>

typedef struct {
    PREFIX_memory memory;
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
} instance_of_fmu;

/* Say what is wrong, and return the status for it. */
static fmi3Status refuse(const instance_of_fmu *instance, const char *message)
{
    if ((instance != NULL) && (instance->log != NULL)) {
        instance->log(instance->environment, fmi3Error, "logStatusError", message);
    }
    return fmi3Error;
}

/* Go from one mode to the next. */
static fmi3Status change(instance_of_fmu *instance, PREFIX_mode from, PREFIX_mode to)
{
    fmi3Status status = fmi3OK;
    if (instance == NULL) {
        status = fmi3Error;
    } else if (instance->memory.mode != from) {
        status = refuse(instance, "this function is not to be called now");
    } else {
        instance->memory.mode = to;
    }
    return status;
}

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[])
{
    (void)loggingOn; /* errors are always told, and there is nothing else to tell */
    (void)nCategories;
    (void)categories;
    return (instance == NULL) ? fmi3Error : fmi3OK;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage)
{
    (void)instanceName;
    (void)instantiationToken;
    (void)resourcePath;
    (void)visible;
    (void)loggingOn;
    if (logMessage != NULL) {
        logMessage(instanceEnvironment, fmi3Error, "logStatusError", "this unit is for co-simulation");
    }
    return NULL;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken,
                                         fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                         fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference requiredIntermediateVariables[],
                                         size_t nRequiredIntermediateVariables,
                                         fmi3InstanceEnvironment instanceEnvironment,
                                         fmi3LogMessageCallback logMessage,
                                         fmi3IntermediateUpdateCallback intermediateUpdate)
{
    instance_of_fmu *made = NULL;
    const char *wrong = NULL;
    (void)resourcePath;
    (void)visible;
    (void)loggingOn;
    (void)earlyReturnAllowed;
    (void)requiredIntermediateVariables;
    (void)(intermediateUpdate == NULL);
    if ((instantiationToken == NULL) || (strcmp(instantiationToken, PREFIX_TOKEN) != 0)) {
        wrong = "the token is that of another unit";
    } else if (eventModeUsed || (nRequiredIntermediateVariables > 0U)) {
        wrong = "there is no event mode, and there are no intermediate values";
    } else if (instanceName == NULL) {
        wrong = "the instance has no name";
    } else {
        made = (instance_of_fmu *)calloc(1U, sizeof(instance_of_fmu));
    }
    if (made != NULL) {
        made->log = logMessage;
        made->environment = instanceEnvironment;
        PREFIX_fmu_reset(&made->memory);
    } else if (logMessage != NULL) {
        logMessage(instanceEnvironment, fmi3Error, "logStatusError", (wrong == NULL) ? "there is no memory" : wrong);
    } else {
        /* nobody to tell it to */
    }
    return made;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String instanceName, fmi3String instantiationToken,
                                               fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                               fmi3InstanceEnvironment instanceEnvironment,
                                               fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate,
                                               fmi3LockPreemptionCallback lockPreemption,
                                               fmi3UnlockPreemptionCallback unlockPreemption)
{
    (void)instanceName;
    (void)instantiationToken;
    (void)resourcePath;
    (void)visible;
    (void)loggingOn;
    (void)(clockUpdate == NULL);
    (void)(lockPreemption == NULL);
    (void)(unlockPreemption == NULL);
    if (logMessage != NULL) {
        logMessage(instanceEnvironment, fmi3Error, "logStatusError", "this unit is for co-simulation");
    }
    return NULL;
}

void fmi3FreeInstance(fmi3Instance instance)
{
    free(instance);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    instance_of_fmu *own = (instance_of_fmu *)instance;
    fmi3Status status = change(own, PREFIX_INSTANTIATED, PREFIX_INITIALIZING);
    (void)toleranceDefined;
    (void)tolerance;
    (void)stopTimeDefined;
    (void)stopTime;
    if ((status == fmi3OK) && !PREFIX_fmu_start(&own->memory, startTime)) {
        own->memory.mode = PREFIX_INSTANTIATED;
        status = refuse(own, "the start time is no number, or so large that samples cannot be told apart");
    }
    return status;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    return change((instance_of_fmu *)instance, PREFIX_INITIALIZING, PREFIX_STEPPING);
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance)
{
    return refuse((const instance_of_fmu *)instance, "there is no event mode");
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    return change((instance_of_fmu *)instance, PREFIX_STEPPING, PREFIX_TERMINATED);
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    instance_of_fmu *own = (instance_of_fmu *)instance;
    if (own != NULL) {
        PREFIX_fmu_reset(&own->memory);
    }
    return (own == NULL) ? fmi3Error : fmi3OK;
}

fmi3Status fmi3GetFloat32(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          fmi3Float32 values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          fmi3Float64 values[], size_t nValues)
{
    const instance_of_fmu *own = (const instance_of_fmu *)instance;
    bool there = (own != NULL) && (nValues == nValueReferences);
    size_t k;
    for (k = 0U; there && (k < nValueReferences); k++) {
        there = PREFIX_fmu_get_real(&own->memory, valueReferences[k], &values[k]);
    }
    return there ? fmi3OK : refuse(own, "there is no Float64 of this reference, or another number of values");
}

fmi3Status fmi3GetInt8(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                       fmi3Int8 values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3GetUInt8(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        fmi3UInt8 values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3GetInt16(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        fmi3Int16 values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3GetUInt16(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         fmi3UInt16 values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3GetInt32(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        fmi3Int32 values[], size_t nValues)
{
    const instance_of_fmu *own = (const instance_of_fmu *)instance;
    bool there = (own != NULL) && (nValues == nValueReferences);
    size_t k;
    for (k = 0U; there && (k < nValueReferences); k++) {
        there = PREFIX_fmu_get_count(&own->memory, valueReferences[k], &values[k]);
    }
    return there ? fmi3OK : refuse(own, "there is no Int32 of this reference, or another number of values");
}

fmi3Status fmi3GetUInt32(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         fmi3UInt32 values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3GetInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        fmi3Int64 values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3GetUInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         fmi3UInt64 values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3GetBoolean(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          fmi3Boolean values[], size_t nValues)
{
    const instance_of_fmu *own = (const instance_of_fmu *)instance;
    bool there = (own != NULL) && (nValues == nValueReferences);
    size_t k;
    for (k = 0U; there && (k < nValueReferences); k++) {
        there = PREFIX_fmu_get_flag(&own->memory, valueReferences[k], &values[k]);
    }
    return there ? fmi3OK : refuse(own, "there is no Boolean of this reference, or another number of values");
}

fmi3Status fmi3GetString(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         fmi3String values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         size_t valueSizes[], fmi3Binary values[], size_t nValues)
{
    (void)valueReferences;
    (void)valueSizes;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3GetClock(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        fmi3Clock values[])
{
    (void)valueReferences;
    (void)values;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3SetFloat32(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          const fmi3Float32 values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          const fmi3Float64 values[], size_t nValues)
{
    instance_of_fmu *own = (instance_of_fmu *)instance;
    bool set = (own != NULL) && (nValues == nValueReferences);
    size_t k;
    for (k = 0U; set && (k < nValueReferences); k++) {
        set = PREFIX_fmu_set_real(&own->memory, valueReferences[k], values[k]);
    }
    return set ? fmi3OK : refuse(own, "there is no Float64 input of this reference, or it cannot be set any more");
}

fmi3Status fmi3SetInt8(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                       const fmi3Int8 values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3SetUInt8(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        const fmi3UInt8 values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3SetInt16(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        const fmi3Int16 values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3SetUInt16(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         const fmi3UInt16 values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3SetInt32(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        const fmi3Int32 values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3SetUInt32(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         const fmi3UInt32 values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3SetInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        const fmi3Int64 values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3SetUInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         const fmi3UInt64 values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3SetBoolean(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          const fmi3Boolean values[], size_t nValues)
{
    instance_of_fmu *own = (instance_of_fmu *)instance;
    bool set = (own != NULL) && (nValues == nValueReferences);
    size_t k;
    for (k = 0U; set && (k < nValueReferences); k++) {
        set = PREFIX_fmu_set_flag(&own->memory, valueReferences[k], values[k]);
    }
    return set ? fmi3OK : refuse(own, "hold_inputs is the only Boolean to set, and only before initialisation ends");
}

fmi3Status fmi3SetString(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         const fmi3String values[], size_t nValues)
{
    (void)valueReferences;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         const size_t valueSizes[], const fmi3Binary values[], size_t nValues)
{
    (void)valueReferences;
    (void)valueSizes;
    (void)values;
    (void)nValues;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3SetClock(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        const fmi3Clock values[])
{
    (void)valueReferences;
    (void)values;
    return (nValueReferences == 0U) ? fmi3OK : refuse((const instance_of_fmu *)instance, "there are no such variables");
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance instance, fmi3ValueReference valueReference,
                                               size_t *nDependencies)
{
    (void)valueReference;
    (void)nDependencies;
    return refuse((const instance_of_fmu *)instance, "dependencies do not change");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance instance, fmi3ValueReference dependent,
                                       size_t elementIndicesOfDependent[], fmi3ValueReference independents[],
                                       size_t elementIndicesOfIndependents[], fmi3DependencyKind dependencyKinds[],
                                       size_t nDependencies)
{
    (void)dependent;
    (void)elementIndicesOfDependent;
    (void)independents;
    (void)elementIndicesOfIndependents;
    (void)dependencyKinds;
    (void)nDependencies;
    return refuse((const instance_of_fmu *)instance, "dependencies do not change");
}

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    const instance_of_fmu *own = (const instance_of_fmu *)instance;
    fmi3Status status = fmi3Error;
    if ((own != NULL) && (FMUState != NULL)) {
        if (*FMUState == NULL) {
            *FMUState = malloc(sizeof(PREFIX_memory));
        }
        if (*FMUState != NULL) {
            (void)memcpy(*FMUState, &own->memory, sizeof(PREFIX_memory));
            status = fmi3OK;
        }
    }
    return (status == fmi3OK) ? status : refuse(own, "there is no memory for the state");
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState)
{
    instance_of_fmu *own = (instance_of_fmu *)instance;
    const bool there = (own != NULL) && (FMUState != NULL);
    if (there) {
        (void)memcpy(&own->memory, FMUState, sizeof(PREFIX_memory));
    }
    return there ? fmi3OK : refuse(own, "there is no state to set");
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    if ((instance != NULL) && (FMUState != NULL)) {
        free(*FMUState);
        *FMUState = NULL;
    }
    return (instance == NULL) ? fmi3Error : fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t *size)
{
    const bool there = (instance != NULL) && (FMUState != NULL) && (size != NULL);
    if (there) {
        *size = PREFIX_SERIALIZED_SIZE;
    }
    return there ? fmi3OK : refuse((const instance_of_fmu *)instance, "there is no state to serialise");
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState, fmi3Byte serializedState[],
                                 size_t size)
{
    const instance_of_fmu *own = (const instance_of_fmu *)instance;
    const bool there = (own != NULL) && (FMUState != NULL) && (serializedState != NULL);
    const bool fits = there && (size >= PREFIX_SERIALIZED_SIZE);
    if (fits) {
        PREFIX_fmu_serialize((const PREFIX_memory *)FMUState, serializedState);
    }
    return fits ? fmi3OK : refuse(own, "there is no state to serialise, or no place for it");
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[], size_t size,
                                   fmi3FMUState *FMUState)
{
    const instance_of_fmu *own = (const instance_of_fmu *)instance;
    PREFIX_memory memory;
    bool done = (own != NULL) && (serializedState != NULL) && (FMUState != NULL);
    done = done && PREFIX_fmu_deserialize(serializedState, size, &memory);
    if (done && (*FMUState == NULL)) {
        *FMUState = malloc(sizeof(PREFIX_memory));
        done = *FMUState != NULL;
    }
    if (done) {
        (void)memcpy(*FMUState, &memory, sizeof(PREFIX_memory));
    }
    return done ? fmi3OK : refuse(own, "these bytes are no state of this monitor, or are damaged");
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                        const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
                                        size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
{
    (void)unknowns;
    (void)nUnknowns;
    (void)knowns;
    (void)nKnowns;
    (void)seed;
    (void)nSeed;
    (void)sensitivity;
    (void)nSensitivity;
    return refuse((const instance_of_fmu *)instance, "there are no derivatives");
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                    const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
                                    size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
{
    (void)unknowns;
    (void)nUnknowns;
    (void)knowns;
    (void)nKnowns;
    (void)seed;
    (void)nSeed;
    (void)sensitivity;
    (void)nSensitivity;
    return refuse((const instance_of_fmu *)instance, "there are no derivatives");
}

fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance)
{
    return refuse((const instance_of_fmu *)instance, "there are no structural parameters");
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance)
{
    return refuse((const instance_of_fmu *)instance, "there are no structural parameters");
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                  size_t nValueReferences, fmi3Float64 intervals[],
                                  fmi3IntervalQualifier qualifiers[])
{
    (void)valueReferences;
    (void)nValueReferences;
    (void)intervals;
    (void)qualifiers;
    return refuse((const instance_of_fmu *)instance, "there are no clocks");
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                   size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
                                   fmi3IntervalQualifier qualifiers[])
{
    (void)valueReferences;
    (void)nValueReferences;
    (void)counters;
    (void)resolutions;
    (void)qualifiers;
    return refuse((const instance_of_fmu *)instance, "there are no clocks");
}

fmi3Status fmi3GetShiftDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                               size_t nValueReferences, fmi3Float64 shifts[])
{
    (void)valueReferences;
    (void)nValueReferences;
    (void)shifts;
    return refuse((const instance_of_fmu *)instance, "there are no clocks");
}

fmi3Status fmi3GetShiftFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
{
    (void)valueReferences;
    (void)nValueReferences;
    (void)counters;
    (void)resolutions;
    return refuse((const instance_of_fmu *)instance, "there are no clocks");
}

fmi3Status fmi3SetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                  size_t nValueReferences, const fmi3Float64 intervals[])
{
    (void)valueReferences;
    (void)nValueReferences;
    (void)intervals;
    return refuse((const instance_of_fmu *)instance, "there are no clocks");
}

fmi3Status fmi3SetIntervalFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                   size_t nValueReferences, const fmi3UInt64 counters[],
                                   const fmi3UInt64 resolutions[])
{
    (void)valueReferences;
    (void)nValueReferences;
    (void)counters;
    (void)resolutions;
    return refuse((const instance_of_fmu *)instance, "there are no clocks");
}

fmi3Status fmi3SetShiftDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                               size_t nValueReferences, const fmi3Float64 shifts[])
{
    (void)valueReferences;
    (void)nValueReferences;
    (void)shifts;
    return refuse((const instance_of_fmu *)instance, "there are no clocks");
}

fmi3Status fmi3SetShiftFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                size_t nValueReferences, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
{
    (void)valueReferences;
    (void)nValueReferences;
    (void)counters;
    (void)resolutions;
    return refuse((const instance_of_fmu *)instance, "there are no clocks");
}

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance)
{
    return refuse((const instance_of_fmu *)instance, "there is no event mode");
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate,
                                    fmi3Boolean *terminateSimulation, fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged, fmi3Boolean *nextEventTimeDefined,
                                    fmi3Float64 *nextEventTime)
{
    (void)discreteStatesNeedUpdate;
    (void)terminateSimulation;
    (void)nominalsOfContinuousStatesChanged;
    (void)valuesOfContinuousStatesChanged;
    (void)nextEventTimeDefined;
    (void)nextEventTime;
    return refuse((const instance_of_fmu *)instance, "there is no event mode");
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance)
{
    return refuse((const instance_of_fmu *)instance, "this unit is for co-simulation");
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    (void)enterEventMode;
    (void)terminateSimulation;
    return refuse((const instance_of_fmu *)instance, "this unit is for co-simulation");
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time)
{
    (void)time;
    return refuse((const instance_of_fmu *)instance, "this unit is for co-simulation");
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 continuousStates[],
                                   size_t nContinuousStates)
{
    (void)continuousStates;
    (void)nContinuousStates;
    return refuse((const instance_of_fmu *)instance, "this unit is for co-simulation");
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[],
                                             size_t nContinuousStates)
{
    (void)derivatives;
    (void)nContinuousStates;
    return refuse((const instance_of_fmu *)instance, "there are no derivatives");
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 eventIndicators[], size_t nEventIndicators)
{
    (void)eventIndicators;
    (void)nEventIndicators;
    return refuse((const instance_of_fmu *)instance, "there is no event mode");
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 continuousStates[], size_t nContinuousStates)
{
    (void)continuousStates;
    (void)nContinuousStates;
    return refuse((const instance_of_fmu *)instance, "this unit is for co-simulation");
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[], size_t nContinuousStates)
{
    (void)nominals;
    (void)nContinuousStates;
    return refuse((const instance_of_fmu *)instance, "this unit is for co-simulation");
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *nEventIndicators)
{
    (void)nEventIndicators;
    return refuse((const instance_of_fmu *)instance, "there is no event mode");
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *nContinuousStates)
{
    (void)nContinuousStates;
    return refuse((const instance_of_fmu *)instance, "this unit is for co-simulation");
}

fmi3Status fmi3EnterStepMode(fmi3Instance instance)
{
    return refuse((const instance_of_fmu *)instance, "there is no event mode");
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                    size_t nValueReferences, const fmi3Int32 orders[], fmi3Float64 values[],
                                    size_t nValues)
{
    (void)valueReferences;
    (void)nValueReferences;
    (void)orders;
    (void)values;
    (void)nValues;
    return refuse((const instance_of_fmu *)instance, "there are no derivatives");
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded,
                      fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    instance_of_fmu *own = (instance_of_fmu *)instance;
    fmi3Status status = change(own, PREFIX_STEPPING, PREFIX_STEPPING);
    (void)noSetFMUStatePriorToCurrentPoint;
    *eventHandlingNeeded = fmi3False;
    *terminateSimulation = fmi3False;
    *earlyReturn = fmi3False;
    if (status == fmi3OK) {
        const char *refused = PREFIX_fmu_step(&own->memory, currentCommunicationPoint, communicationStepSize);
        if (refused != NULL) {
            status = refuse(own, refused);
        }
        *lastSuccessfulTime = own->memory.time;
    }
    return status;
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance instance, fmi3ValueReference clockReference,
                                      fmi3Float64 activationTime)
{
    (void)clockReference;
    (void)activationTime;
    return refuse((const instance_of_fmu *)instance, "there are no model partitions");
}
