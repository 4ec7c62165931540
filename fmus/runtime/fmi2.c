/* FMI 2.0, Co-Simulation and Model Exchange, over the core. */

#include <stdlib.h>

#include "core.c"
#include "fmi2Functions.h"

typedef struct {
    Instance model;
    fmi2CallbackFunctions callbacks;
    char *name;
    bool is_co_simulation;
} Component;

/* Report what went wrong, and answer fmi2Error. */
static fmi2Status report(Component *c)
{
    if (c->callbacks.logger != NULL)
        c->callbacks.logger(c->callbacks.componentEnvironment, c->name, fmi2Error,
                            "logStatusError", "%s", c->model.message);
    return fmi2Error;
}

static fmi2Status status_of(Component *c, bool succeeded)
{
    return succeeded ? fmi2OK : report(c);
}

static fmi2Status refuse(Component *c, const char *what)
{
    fail(&c->model, "%s", what);
    return report(c);
}

/* Life of an instance */

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Status fmi2SetDebugLogging(fmi2Component component, fmi2Boolean on, size_t n,
                               const fmi2String categories[])
{
    (void)component, (void)on, (void)n, (void)categories; /* only errors are logged, and always */
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible,
                              fmi2Boolean logging)
{
    (void)resources, (void)visible, (void)logging;
    if (guid == NULL || strcmp(guid, MODEL_GUID) != 0) {
        if (callbacks != NULL && callbacks->logger != NULL)
            callbacks->logger(callbacks->componentEnvironment, name, fmi2Error, "logStatusError",
                              "the GUID of modelDescription.xml is not that of the binary");
        return NULL;
    }
    Component *c = calloc(1, sizeof *c);
    const char *shown = name != NULL ? name : "";
    if (c == NULL || (c->name = malloc(strlen(shown) + 1)) == NULL) {
        free(c);
        return NULL;
    }
    strcpy(c->name, shown);
    if (callbacks != NULL)
        c->callbacks = *callbacks;
    c->is_co_simulation = type == fmi2CoSimulation;
    instance_reset(&c->model);
    return c;
}

void fmi2FreeInstance(fmi2Component component)
{
    Component *c = component;
    if (c != NULL)
        free(c->name);
    free(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component component, fmi2Boolean tolerance_defined,
                               fmi2Real tolerance, fmi2Real start, fmi2Boolean stop_defined,
                               fmi2Real stop)
{
    (void)stop_defined, (void)stop;
    Component *c = component;
    if (tolerance_defined && tolerance > 0)
        c->model.now.tolerance = fmin(fmax(tolerance, 1e-13), 1e-2);
    c->model.now.values[TIME] = start;
    instance_changed(&c->model);
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component component)
{
    ((Component *)component)->model.now.phase = INITIALISING;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component component)
{
    Component *c = component;
    if (!instance_initialise(&c->model))
        return report(c);
    c->model.now.phase = c->is_co_simulation ? CONTINUOUS : EVENTS;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component component)
{
    ((Component *)component)->model.now.phase = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component component)
{
    instance_reset(&((Component *)component)->model);
    return fmi2OK;
}

/* Values; Integer and Boolean parameters are kept as Real */

static bool get(Component *c, const fmi2ValueReference vr[], size_t n)
{
    bool started = false, computed = false;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= N_VALUES)
            return fail(&c->model, "there is no value reference %u", vr[i]);
        started = started || vr[i] >= STATES; /* may be computed from parameters at the start */
        computed = computed || vr[i] >= DERIVATIVES;
    }
    if (computed)
        return instance_compute(&c->model);
    if (started && c->model.now.phase <= INITIALISING)
        return instance_initialise(&c->model);
    return true;
}

static bool set(Component *c, fmi2ValueReference vr, double value)
{
    if (!is_settable(&c->model, vr))
        return fail(&c->model, "the value with reference %u cannot be set now", vr);
    c->model.now.values[vr] = value;
    instance_changed(&c->model);
    return true;
}

#define GETTER(Type)                                                                               \
    fmi2Status fmi2Get##Type(fmi2Component component, const fmi2ValueReference vr[], size_t n,     \
                             fmi2##Type value[])                                                   \
    {                                                                                              \
        Component *c = component;                                                                  \
        if (!get(c, vr, n))                                                                        \
            return report(c);                                                                      \
        for (size_t i = 0; i < n; i++)                                                             \
            value[i] = (fmi2##Type)c->model.now.values[vr[i]];                                     \
        return fmi2OK;                                                                             \
    }

#define SETTER(Type)                                                                               \
    fmi2Status fmi2Set##Type(fmi2Component component, const fmi2ValueReference vr[], size_t n,     \
                             const fmi2##Type value[])                                             \
    {                                                                                              \
        Component *c = component;                                                                  \
        for (size_t i = 0; i < n; i++)                                                             \
            if (!set(c, vr[i], (double)value[i]))                                                  \
                return report(c);                                                                  \
        return fmi2OK;                                                                             \
    }

GETTER(Real)
GETTER(Integer)
GETTER(Boolean)
SETTER(Real)
SETTER(Integer)
SETTER(Boolean)

fmi2Status fmi2GetString(fmi2Component component, const fmi2ValueReference vr[], size_t n,
                         fmi2String value[])
{
    (void)vr, (void)value;
    return n == 0 ? fmi2OK : refuse(component, "the model has no strings");
}

fmi2Status fmi2SetString(fmi2Component component, const fmi2ValueReference vr[], size_t n,
                         const fmi2String value[])
{
    (void)vr, (void)value;
    return n == 0 ? fmi2OK : refuse(component, "the model has no strings");
}

/* State of an instance: a copy of everything that changes */

fmi2Status fmi2GetFMUstate(fmi2Component component, fmi2FMUstate *state)
{
    Component *c = component;
    if (*state == NULL)
        *state = malloc(sizeof(State));
    if (*state == NULL)
        return refuse(c, "no memory for the state");
    memcpy(*state, &c->model.now, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate state)
{
    Component *c = component;
    if (state == NULL)
        return refuse(c, "there is no state to set");
    memcpy(&c->model.now, state, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component component, fmi2FMUstate *state)
{
    (void)component;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component component, fmi2FMUstate state, size_t *size)
{
    (void)component, (void)state;
    *size = sizeof(State);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component component, fmi2FMUstate state, fmi2Byte bytes[],
                                 size_t size)
{
    if (size < sizeof(State))
        return refuse(component, "too few bytes for the state");
    memcpy(bytes, state, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component component, const fmi2Byte bytes[], size_t size,
                                   fmi2FMUstate *state)
{
    if (size != sizeof(State))
        return refuse(component, "the bytes are not a state of this FMU");
    if (*state == NULL)
        *state = malloc(sizeof(State));
    if (*state == NULL)
        return refuse(component, "no memory for the state");
    memcpy(*state, bytes, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component component, const fmi2ValueReference unknown[],
                                        size_t n_unknown, const fmi2ValueReference known[],
                                        size_t n_known, const fmi2Real seed_known[],
                                        fmi2Real change_unknown[])
{
    Component *c = component;
    double seed[N_VALUES] = {0}, *change = seed + DERIVATIVES;
    for (size_t i = 0; i < n_known; i++) {
        if (known[i] < PARAMETERS || known[i] >= DISCRETES)
            return refuse(c, "derivatives exist by parameters, inputs and continuous states");
        seed[known[i]] = seed_known[i];
    }
    if (c->model.now.phase <= INITIALISING && !instance_initialise(&c->model))
        return report(c);
    directional_derivative(&c->model, seed, change);
    for (size_t i = 0; i < n_unknown; i++) {
        if (unknown[i] >= N_VALUES)
            return refuse(c, "there is no such value reference");
        change_unknown[i] = seed[unknown[i]];
    }
    return fmi2OK;
}

/* Model Exchange */

fmi2Status fmi2EnterEventMode(fmi2Component component)
{
    Component *c = component;
    history_record(&c->model); /* as it is just before the event */
    c->model.now.phase = EVENTS;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component component, fmi2EventInfo *info)
{
    Component *c = component;
    double before[ROOM(N_STATES)];
    memcpy(before, c->model.now.values + STATES, N_STATES * sizeof(double));
    if (!events_update(&c->model))
        return report(c);
    const double next = history_next_jump(&c->model);
    *info = (fmi2EventInfo){
        .valuesOfContinuousStatesChanged =
            memcmp(before, c->model.now.values + STATES, N_STATES * sizeof(double)) != 0,
        .nextEventTimeDefined = next < DBL_MAX,
        .nextEventTime = next,
    };
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component component)
{
    ((Component *)component)->model.now.phase = CONTINUOUS;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component component, fmi2Boolean state_stays,
                                       fmi2Boolean *enter_event_mode, fmi2Boolean *terminate)
{
    (void)state_stays;
    history_record(&((Component *)component)->model);
    *enter_event_mode = *terminate = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component component, fmi2Real time)
{
    Component *c = component;
    c->model.now.values[TIME] = time;
    instance_changed(&c->model);
    return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component component, const fmi2Real x[], size_t n)
{
    Component *c = component;
    if (n != N_STATES)
        return refuse(c, "the number of continuous states is another");
    memcpy(c->model.now.values + STATES, x, N_STATES * sizeof(double));
    c->model.now.computed = false;
    return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component component, fmi2Real x[], size_t n)
{
    Component *c = component;
    if (n != N_STATES)
        return refuse(c, "the number of continuous states is another");
    memcpy(x, c->model.now.values + STATES, N_STATES * sizeof(double));
    return fmi2OK;
}

fmi2Status fmi2GetDerivatives(fmi2Component component, fmi2Real derivatives[], size_t n)
{
    Component *c = component;
    if (n != N_STATES)
        return refuse(c, "the number of continuous states is another");
    evaluate_derivatives(&c->model, c->model.now.values[TIME], c->model.now.values + STATES,
                         derivatives);
    return fmi2OK;
}

fmi2Status fmi2GetEventIndicators(fmi2Component component, fmi2Real indicators[], size_t n)
{
    Component *c = component;
    if (n != N_RELATIONS)
        return refuse(c, "the number of event indicators is another");
    event_indicators(&c->model, indicators);
    return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component component, fmi2Real nominals[], size_t n)
{
    if (n != N_STATES)
        return refuse(component, "the number of continuous states is another");
    memcpy(nominals, model_nominals, N_STATES * sizeof(double));
    return fmi2OK;
}

/* Co-Simulation */

fmi2Status fmi2DoStep(fmi2Component component, fmi2Real time, fmi2Real step,
                      fmi2Boolean no_set_state)
{
    (void)no_set_state;
    Component *c = component;
    Instance *m = &c->model;
    if (m->now.phase != CONTINUOUS)
        return refuse(c, "a step before the end of initialization");
    if (fabs(time - m->now.values[TIME]) > 1e-6 * fmax(step, fabs(time))) {
        fail(m, "a step from time %.9g, but the model is at %.9g", time, m->now.values[TIME]);
        return report(c);
    }
    const bool succeeded = solver_advance(m, time + step);
    memset(m->now.slopes, 0, sizeof m->now.slopes);
    return status_of(c, succeeded);
}

fmi2Status fmi2CancelStep(fmi2Component component)
{
    return refuse(component, "steps are never pending");
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component component, const fmi2ValueReference vr[],
                                       size_t n, const fmi2Integer order[], const fmi2Real value[])
{
    Component *c = component;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] < INPUTS || vr[i] >= STATES || order[i] != 1)
            return refuse(c, "only first derivatives of inputs can be set");
        c->model.now.slopes[vr[i] - INPUTS] = value[i];
    }
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component component, const fmi2ValueReference vr[],
                                        size_t n, const fmi2Integer order[], fmi2Real value[])
{
    (void)vr, (void)order, (void)value;
    return n == 0 ? fmi2OK : refuse(component, "derivatives of outputs are not provided");
}

fmi2Status fmi2GetStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)kind, (void)value;
    return refuse(component, "steps are never pending");
}

fmi2Status fmi2GetRealStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Real *value)
{
    Component *c = component;
    if (kind != fmi2LastSuccessfulTime)
        return refuse(c, "only the last successful time is known");
    *value = c->model.now.values[TIME];
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component component, const fmi2StatusKind kind,
                                fmi2Integer *value)
{
    (void)kind, (void)value;
    return refuse(component, "there is no status of this kind");
}

fmi2Status fmi2GetBooleanStatus(fmi2Component component, const fmi2StatusKind kind,
                                fmi2Boolean *value)
{
    Component *c = component;
    if (kind != fmi2Terminated)
        return refuse(c, "there is no status of this kind");
    *value = c->model.now.phase == TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component component, const fmi2StatusKind kind,
                               fmi2String *value)
{
    (void)kind, (void)value;
    return refuse(component, "there is no status of this kind");
}
