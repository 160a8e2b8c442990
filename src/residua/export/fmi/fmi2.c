/*
 * The functions of FMI 2.0 for co-simulation.
 */
#include "fmi2Functions.h"
#include "PREFIX_fmu.h"
#include <stdlib.h>
#include <string.h>

#define NAME_LENGTH 64

typedef struct {
    PREFIX_memory memory;
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
    char name[NAME_LENGTH];
} instance_of_fmu;

/* Say what is wrong, and return the status for it. */
static fmi2Status refuse(const instance_of_fmu *instance, const char *message)
{
    if ((instance != NULL) && (instance->logger != NULL)) {
        instance->logger(instance->environment, instance->name, fmi2Error, "logStatusError", message);
    }
    return fmi2Error;
}

/* Go from one mode to the next. */
static fmi2Status change(instance_of_fmu *instance, PREFIX_mode from, PREFIX_mode to)
{
    fmi2Status status = fmi2OK;
    if (instance == NULL) {
        status = fmi2Error;
    } else if (instance->memory.mode != from) {
        status = refuse(instance, "this function is not to be called now");
    } else {
        instance->memory.mode = to;
    }
    return status;
}

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return "2.0";
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[])
{
    (void)loggingOn; /* errors are always told, and there is nothing else to tell */
    (void)nCategories;
    (void)categories;
    return (c == NULL) ? fmi2Error : fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    instance_of_fmu *made = NULL;
    const bool ours = (fmuGUID != NULL) && (strcmp(fmuGUID, PREFIX_TOKEN) == 0);
    (void)fmuResourceLocation;
    (void)visible;
    (void)loggingOn;
    if ((instanceName != NULL) && (functions != NULL)) {
        if (ours && (fmuType == fmi2CoSimulation)) {
            made = (instance_of_fmu *)calloc(1U, sizeof(instance_of_fmu));
        } else if (functions->logger != NULL) {
            functions->logger(functions->componentEnvironment, instanceName, fmi2Error, "logStatusError",
                              ours ? "this unit is for co-simulation" : "the GUID is that of another unit");
        } else {
            /* nobody to tell it to */
        }
    }
    if (made != NULL) {
        made->logger = functions->logger;
        made->environment = functions->componentEnvironment;
        (void)strncpy(made->name, instanceName, NAME_LENGTH - 1);
        PREFIX_fmu_reset(&made->memory);
    }
    return made;
}

void fmi2FreeInstance(fmi2Component c)
{
    free(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    instance_of_fmu *instance = (instance_of_fmu *)c;
    fmi2Status status = change(instance, PREFIX_INSTANTIATED, PREFIX_INSTANTIATED);
    (void)toleranceDefined;
    (void)tolerance;
    (void)stopTimeDefined;
    (void)stopTime;
    if ((status == fmi2OK) && !PREFIX_fmu_start(&instance->memory, startTime)) {
        status = refuse(instance, "the start time is no number, or so large that samples cannot be told apart");
    }
    return status;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    return change((instance_of_fmu *)c, PREFIX_INSTANTIATED, PREFIX_INITIALIZING);
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    return change((instance_of_fmu *)c, PREFIX_INITIALIZING, PREFIX_STEPPING);
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    return change((instance_of_fmu *)c, PREFIX_STEPPING, PREFIX_TERMINATED);
}

fmi2Status fmi2Reset(fmi2Component c)
{
    instance_of_fmu *instance = (instance_of_fmu *)c;
    if (instance != NULL) {
        PREFIX_fmu_reset(&instance->memory);
    }
    return (instance == NULL) ? fmi2Error : fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    const instance_of_fmu *instance = (const instance_of_fmu *)c;
    bool there = instance != NULL;
    size_t k;
    for (k = 0U; there && (k < nvr); k++) {
        there = PREFIX_fmu_get_real(&instance->memory, vr[k], &value[k]);
    }
    return there ? fmi2OK : refuse(instance, "there is no real variable of this reference");
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Integer value[])
{
    const instance_of_fmu *instance = (const instance_of_fmu *)c;
    bool there = instance != NULL;
    size_t k;
    for (k = 0U; there && (k < nvr); k++) {
        int32_t count = 0;
        there = PREFIX_fmu_get_count(&instance->memory, vr[k], &count);
        value[k] = count;
    }
    return there ? fmi2OK : refuse(instance, "there is no integer variable of this reference");
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Boolean value[])
{
    const instance_of_fmu *instance = (const instance_of_fmu *)c;
    bool there = instance != NULL;
    size_t k;
    for (k = 0U; there && (k < nvr); k++) {
        bool flag = false;
        there = PREFIX_fmu_get_flag(&instance->memory, vr[k], &flag);
        if (flag) {
            value[k] = fmi2True;
        } else {
            value[k] = fmi2False;
        }
    }
    return there ? fmi2OK : refuse(instance, "there is no Boolean variable of this reference");
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[])
{
    (void)vr;
    (void)value;
    return ((c != NULL) && (nvr == 0U)) ? fmi2OK : refuse((const instance_of_fmu *)c, "there are no strings");
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    instance_of_fmu *instance = (instance_of_fmu *)c;
    bool set = instance != NULL;
    size_t k;
    for (k = 0U; set && (k < nvr); k++) {
        set = PREFIX_fmu_set_real(&instance->memory, vr[k], value[k]);
    }
    return set ? fmi2OK : refuse(instance, "there is no real input of this reference, or it cannot be set any more");
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer value[])
{
    (void)vr;
    (void)value;
    return ((c != NULL) && (nvr == 0U)) ? fmi2OK : refuse((const instance_of_fmu *)c, "there are no integer inputs");
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Boolean value[])
{
    instance_of_fmu *instance = (instance_of_fmu *)c;
    bool set = instance != NULL;
    size_t k;
    for (k = 0U; set && (k < nvr); k++) {
        set = PREFIX_fmu_set_flag(&instance->memory, vr[k], value[k] != fmi2False);
    }
    return set ? fmi2OK : refuse(instance, "hold_inputs is the only flag to set, and only before initialisation ends");
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2String value[])
{
    (void)vr;
    (void)value;
    return ((c != NULL) && (nvr == 0U)) ? fmi2OK : refuse((const instance_of_fmu *)c, "there are no strings");
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    const instance_of_fmu *instance = (const instance_of_fmu *)c;
    fmi2Status status = fmi2Error;
    if ((instance != NULL) && (FMUstate != NULL)) {
        if (*FMUstate == NULL) {
            *FMUstate = malloc(sizeof(PREFIX_memory));
        }
        if (*FMUstate != NULL) {
            (void)memcpy(*FMUstate, &instance->memory, sizeof(PREFIX_memory));
            status = fmi2OK;
        }
    }
    return (status == fmi2OK) ? status : refuse(instance, "there is no memory for the state");
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    instance_of_fmu *instance = (instance_of_fmu *)c;
    const bool there = (instance != NULL) && (FMUstate != NULL);
    if (there) {
        (void)memcpy(&instance->memory, FMUstate, sizeof(PREFIX_memory));
    }
    return there ? fmi2OK : refuse(instance, "there is no state to set");
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    if ((c != NULL) && (FMUstate != NULL)) {
        free(*FMUstate);
        *FMUstate = NULL;
    }
    return (c == NULL) ? fmi2Error : fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    const bool there = (c != NULL) && (FMUstate != NULL) && (size != NULL);
    if (there) {
        *size = PREFIX_SERIALIZED_SIZE;
    }
    return there ? fmi2OK : refuse((const instance_of_fmu *)c, "there is no state to serialise");
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size)
{
    const bool there = (c != NULL) && (FMUstate != NULL) && (serializedState != NULL);
    const bool fits = there && (size >= PREFIX_SERIALIZED_SIZE);
    if (fits) {
        PREFIX_fmu_serialize((const PREFIX_memory *)FMUstate, (uint8_t *)serializedState);
    }
    return fits ? fmi2OK : refuse((const instance_of_fmu *)c, "there is no state to serialise, or no place for it");
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate)
{
    const instance_of_fmu *instance = (const instance_of_fmu *)c;
    PREFIX_memory memory;
    bool done = (c != NULL) && (serializedState != NULL) && (FMUstate != NULL);
    done = done && PREFIX_fmu_deserialize((const uint8_t *)serializedState, size, &memory);
    if (done && (*FMUstate == NULL)) {
        *FMUstate = malloc(sizeof(PREFIX_memory));
        done = *FMUstate != NULL;
    }
    if (done) {
        (void)memcpy(*FMUstate, &memory, sizeof(PREFIX_memory));
    }
    return done ? fmi2OK : refuse(instance, "these bytes are no state of this monitor, or are damaged");
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[], size_t nKnown,
                                        const fmi2Real dvKnown[], fmi2Real dvUnknown[])
{
    (void)vUnknown_ref;
    (void)nUnknown;
    (void)vKnown_ref;
    (void)nKnown;
    (void)dvKnown;
    (void)dvUnknown;
    return refuse((const instance_of_fmu *)c, "there are no derivatives");
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr;
    (void)nvr;
    (void)order;
    (void)value;
    return refuse((const instance_of_fmu *)c, "inputs are not interpolated");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)vr;
    (void)nvr;
    (void)order;
    (void)value;
    return refuse((const instance_of_fmu *)c, "there are no derivatives");
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    instance_of_fmu *instance = (instance_of_fmu *)c;
    fmi2Status status = change(instance, PREFIX_STEPPING, PREFIX_STEPPING);
    (void)noSetFMUStatePriorToCurrentPoint;
    if (status == fmi2OK) {
        const char *refused = PREFIX_fmu_step(&instance->memory, currentCommunicationPoint, communicationStepSize);
        if (refused != NULL) {
            status = refuse(instance, refused);
        }
    }
    return status;
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return refuse((const instance_of_fmu *)c, "steps end before the function returns");
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value)
{
    (void)s;
    (void)value;
    return refuse((const instance_of_fmu *)c, "steps end before the function returns");
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    const instance_of_fmu *instance = (const instance_of_fmu *)c;
    const bool there = (instance != NULL) && (s == fmi2LastSuccessfulTime);
    if (there) {
        *value = instance->memory.time;
    }
    return there ? fmi2OK : refuse(instance, "there is no such status");
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value)
{
    (void)s;
    (void)value;
    return refuse((const instance_of_fmu *)c, "there is no such status");
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    const instance_of_fmu *instance = (const instance_of_fmu *)c;
    const bool there = (instance != NULL) && (s == fmi2Terminated);
    if (there) {
        *value = fmi2False;
    }
    return there ? fmi2OK : refuse(instance, "there is no such status");
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value)
{
    (void)s;
    (void)value;
    return refuse((const instance_of_fmu *)c, "there is no such status");
}
