/* FMI 2.0, Co-Simulation and Model Exchange, over the core. */

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
    begin(&((Component *)component)->model, start, tolerance_defined, tolerance);
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
    return status_of(c, leave_initialisation(&c->model, !c->is_co_simulation));
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

#define GETTER(Type)                                                                               \
    fmi2Status fmi2Get##Type(fmi2Component component, const fmi2ValueReference vr[], size_t n,     \
                             fmi2##Type value[])                                                   \
    {                                                                                              \
        Component *c = component;                                                                  \
        if (!update_values(&c->model, vr, n))                                                                        \
            return report(c);                                                                      \
        for (size_t i = 0; i < n; i++)                                                             \
            value[i] = (fmi2##Type)read_value(&c->model, vr[i]);                                       \
        return fmi2OK;                                                                             \
    }

#define SETTER(Type)                                                                               \
    fmi2Status fmi2Set##Type(fmi2Component component, const fmi2ValueReference vr[], size_t n,     \
                             const fmi2##Type value[])                                             \
    {                                                                                              \
        Component *c = component;                                                                  \
        for (size_t i = 0; i < n; i++)                                                             \
            if (!write_value(&c->model, vr[i], (double)value[i]))                                  \
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
    return status_of(c, copy_state(&c->model, &c->model.now, state));
}

fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate state)
{
    Component *c = component;
    void *now = &c->model.now;
    return status_of(c, copy_state(&c->model, state, &now));
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
    Component *c = component;
    void *to = bytes;
    if (size < sizeof(State))
        return refuse(c, "too few bytes for the state");
    return status_of(c, copy_state(&c->model, state, &to));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component component, const fmi2Byte bytes[], size_t size,
                                   fmi2FMUstate *state)
{
    Component *c = component;
    if (size != sizeof(State))
        return refuse(c, "the bytes are not a state of this FMU");
    return status_of(c, copy_state(&c->model, bytes, state));
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component component, const fmi2ValueReference unknown[],
                                        size_t n_unknown, const fmi2ValueReference known[],
                                        size_t n_known, const fmi2Real seed_known[],
                                        fmi2Real change_unknown[])
{
    Component *c = component;
    return status_of(c, directional_derivative(&c->model, unknown, n_unknown, known, n_known,
                                               seed_known, change_unknown));
}

/* Model Exchange */

fmi2Status fmi2EnterEventMode(fmi2Component component)
{
    enter_event_mode(&((Component *)component)->model);
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component component, fmi2EventInfo *info)
{
    Component *c = component;
    bool states_changed;
    double next;
    if (!update_discrete_states(&c->model, &states_changed, &next))
        return report(c);
    *info = (fmi2EventInfo){
        .terminateSimulation = c->model.now.ended,
        .valuesOfContinuousStatesChanged = states_changed,
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
    return status_of(c, set_states(&c->model, x, n));
}

fmi2Status fmi2GetContinuousStates(fmi2Component component, fmi2Real x[], size_t n)
{
    Component *c = component;
    return status_of(c, get_states(&c->model, x, n));
}

fmi2Status fmi2GetDerivatives(fmi2Component component, fmi2Real derivatives[], size_t n)
{
    Component *c = component;
    return status_of(c, get_derivatives(&c->model, derivatives, n));
}

fmi2Status fmi2GetEventIndicators(fmi2Component component, fmi2Real indicators[], size_t n)
{
    Component *c = component;
    return status_of(c, get_indicators(&c->model, indicators, n));
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component component, fmi2Real nominals[], size_t n)
{
    Component *c = component;
    return status_of(c, get_nominals(&c->model, nominals, n));
}

/* Co-Simulation */

fmi2Status fmi2DoStep(fmi2Component component, fmi2Real time, fmi2Real step,
                      fmi2Boolean no_set_state)
{
    (void)no_set_state;
    Component *c = component;
    if (!do_step(&c->model, time, step))
        return report(c);
    return c->model.now.ended ? fmi2Discard : fmi2OK; /* ended by terminate() of the model */
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
    *value = c->model.now.ended;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component component, const fmi2StatusKind kind,
                               fmi2String *value)
{
    (void)kind, (void)value;
    return refuse(component, "there is no status of this kind");
}
