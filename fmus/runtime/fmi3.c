/* FMI 3.0, Co-Simulation and Model Exchange, over the core. */

#include "core.c"
#include "fmi3Functions.h"

typedef struct {
    Instance model;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    bool is_co_simulation;
    bool has_event_mode;
} Component;

/* Report what went wrong, and answer fmi3Error. */
static fmi3Status report(Component *c)
{
    if (c->log != NULL)
        c->log(c->environment, fmi3Error, "logStatusError", c->model.message);
    return fmi3Error;
}

static fmi3Status status_of(Component *c, bool succeeded)
{
    return succeeded ? fmi3OK : report(c);
}

static fmi3Status refuse(Component *c, const char *what)
{
    fail(&c->model, "%s", what);
    return report(c);
}

/* Life of an instance */

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t n,
                               const fmi3String categories[])
{
    (void)instance, (void)on, (void)n, (void)categories; /* only errors are logged, and always */
    return fmi3OK;
}

static fmi3Instance instantiate(fmi3String token, fmi3InstanceEnvironment environment,
                                fmi3LogMessageCallback log)
{
    if (token == NULL || strcmp(token, MODEL_GUID) != 0) {
        if (log != NULL)
            log(environment, fmi3Error, "logStatusError",
                "the instantiation token of modelDescription.xml is not that of the binary");
        return NULL;
    }
    Component *c = calloc(1, sizeof *c);
    if (c == NULL)
        return NULL;
    c->environment = environment;
    c->log = log;
    instance_reset(&c->model);
    return c;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                          fmi3Boolean visible, fmi3Boolean logging,
                                          fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log)
{
    (void)name, (void)resources, (void)visible, (void)logging;
    return instantiate(token, environment, log);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                         fmi3Boolean visible, fmi3Boolean logging,
                                         fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference intermediate[],
                                         size_t n_intermediate,
                                         fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update)
{
    (void)name, (void)resources, (void)visible, (void)logging;
    (void)intermediate, (void)n_intermediate, (void)update;
    Component *c = instantiate(token, environment, log);
    if (c != NULL) {
        c->is_co_simulation = true;
        c->has_event_mode = event_mode;
        c->model.pauses_at_events = event_mode && early_return;
    }
    return c;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token,
                                               fmi3String resources, fmi3Boolean visible,
                                               fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment,
                                               fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback clock_update,
                                               fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    (void)clock_update, (void)lock, (void)unlock;
    if (log != NULL)
        log(environment, fmi3Error, "logStatusError", "the FMU has no scheduled execution");
    return NULL;
}

void fmi3FreeInstance(fmi3Instance instance)
{
    free(instance);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerance_defined,
                                       fmi3Float64 tolerance, fmi3Float64 start,
                                       fmi3Boolean stop_defined, fmi3Float64 stop)
{
    (void)stop_defined, (void)stop;
    Component *c = instance;
    begin(&c->model, start, tolerance_defined, tolerance);
    c->model.now.phase = INITIALISING;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    Component *c = instance;
    return status_of(c, leave_initialisation(&c->model,
                                             !c->is_co_simulation || c->has_event_mode));
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance)
{
    enter_event_mode(&((Component *)instance)->model);
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    ((Component *)instance)->model.now.phase = TERMINATED;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    Component *c = instance;
    const bool pauses = c->model.pauses_at_events;
    instance_reset(&c->model);
    c->model.pauses_at_events = pauses;
    return fmi3OK;
}

/* Values; integers and Booleans are kept as Float64 */

#define GETTER(Type)                                                                               \
    fmi3Status fmi3Get##Type(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,       \
                             fmi3##Type values[], size_t n_values)                                 \
    {                                                                                              \
        Component *c = instance;                                                                   \
        if (n != n_values)                                                                         \
            return refuse(c, "the model has scalars only");                                        \
        if (!update_values(&c->model, vr, n))                                                      \
            return report(c);                                                                      \
        for (size_t i = 0; i < n; i++)                                                             \
            values[i] = (fmi3##Type)read_value(&c->model, vr[i]);                                  \
        return fmi3OK;                                                                             \
    }

#define SETTER(Type)                                                                               \
    fmi3Status fmi3Set##Type(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,       \
                             const fmi3##Type values[], size_t n_values)                           \
    {                                                                                              \
        Component *c = instance;                                                                   \
        if (n != n_values)                                                                         \
            return refuse(c, "the model has scalars only");                                        \
        for (size_t i = 0; i < n; i++)                                                             \
            if (!write_value(&c->model, vr[i], (double)values[i]))                                 \
                return report(c);                                                                  \
        return fmi3OK;                                                                             \
    }

#define ABSENT(Type)                                                                               \
    fmi3Status fmi3Get##Type(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,       \
                             fmi3##Type values[], size_t n_values)                                 \
    {                                                                                              \
        (void)vr, (void)values, (void)n_values;                                                    \
        return n == 0 ? fmi3OK : refuse(instance, "the model has no variables of type " #Type);    \
    }                                                                                              \
    fmi3Status fmi3Set##Type(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,       \
                             const fmi3##Type values[], size_t n_values)                           \
    {                                                                                              \
        (void)vr, (void)values, (void)n_values;                                                    \
        return n == 0 ? fmi3OK : refuse(instance, "the model has no variables of type " #Type);    \
    }

GETTER(Float64)
GETTER(Int32)
GETTER(Int64)
GETTER(Boolean)
SETTER(Float64)
SETTER(Int32)
SETTER(Int64)
SETTER(Boolean)
ABSENT(Float32)
ABSENT(Int8)
ABSENT(UInt8)
ABSENT(Int16)
ABSENT(UInt16)
ABSENT(UInt32)
ABSENT(UInt64)
ABSENT(String)

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                         size_t sizes[], fmi3Binary values[], size_t n_values)
{
    (void)vr, (void)sizes, (void)values, (void)n_values;
    return n == 0 ? fmi3OK : refuse(instance, "the model has no variables of type Binary");
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                         const size_t sizes[], const fmi3Binary values[], size_t n_values)
{
    (void)vr, (void)sizes, (void)values, (void)n_values;
    return n == 0 ? fmi3OK : refuse(instance, "the model has no variables of type Binary");
}

/* Dependencies are in modelDescription.xml and never change. */

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance instance, fmi3ValueReference vr,
                                               size_t *n)
{
    (void)vr, (void)n;
    return refuse(instance, "dependencies are those of modelDescription.xml");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance instance, fmi3ValueReference dependent,
                                       size_t dependent_elements[],
                                       fmi3ValueReference independents[],
                                       size_t independent_elements[], fmi3DependencyKind kinds[],
                                       size_t n)
{
    (void)dependent, (void)dependent_elements, (void)independents, (void)independent_elements;
    (void)kinds, (void)n;
    return refuse(instance, "dependencies are those of modelDescription.xml");
}

/* State of an instance: a copy of everything that changes */

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    Component *c = instance;
    return status_of(c, copy_state(&c->model, &c->model.now, state));
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state)
{
    Component *c = instance;
    void *now = &c->model.now;
    return status_of(c, copy_state(&c->model, state, &now));
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    (void)instance;
    free(*state);
    *state = NULL;
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *size)
{
    (void)instance, (void)state;
    *size = sizeof(State);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[],
                                 size_t size)
{
    Component *c = instance;
    void *to = bytes;
    if (size < sizeof(State))
        return refuse(c, "too few bytes for the state");
    return status_of(c, copy_state(&c->model, state, &to));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size,
                                   fmi3FMUState *state)
{
    Component *c = instance;
    if (size != sizeof(State))
        return refuse(c, "the bytes are not a state of this FMU");
    return status_of(c, copy_state(&c->model, bytes, state));
}

/* Derivatives */

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                        size_t n_unknowns, const fmi3ValueReference knowns[],
                                        size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
                                        fmi3Float64 sensitivity[], size_t n_sensitivity)
{
    Component *c = instance;
    if (n_seed != n_knowns || n_sensitivity != n_unknowns)
        return refuse(c, "the model has scalars only");
    return status_of(c, directional_derivative(&c->model, unknowns, n_unknowns, knowns, n_knowns,
                                               seed, sensitivity));
}

/* The transposed Jacobian times `seed`. Models have few knowns: one direction for each. */
static bool adjoint_derivative(Instance *m, const unsigned *unknowns, size_t n_unknowns,
                               const unsigned *knowns, size_t n_knowns, const double *seed,
                               double *sensitivity)
{
    if (!is_derivative(m, unknowns, n_unknowns, knowns, n_knowns))
        return false;
    for (size_t k = 0; k < n_knowns; k++) {
        double direction[N_VALUES + N_RELATIONS] = {0};
        direction[knowns[k]] = 1;
        if (!complete_direction(m, direction))
            return false;
        sensitivity[k] = 0;
        for (size_t i = 0; i < n_unknowns; i++)
            sensitivity[k] += seed[i] * direction[unknowns[i]];
    }
    return true;
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                    size_t n_unknowns, const fmi3ValueReference knowns[],
                                    size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
                                    fmi3Float64 sensitivity[], size_t n_sensitivity)
{
    Component *c = instance;
    if (n_seed != n_unknowns || n_sensitivity != n_knowns)
        return refuse(c, "the model has scalars only");
    return status_of(c, adjoint_derivative(&c->model, unknowns, n_unknowns, knowns, n_knowns, seed,
                                           sensitivity));
}

/* Event mode */

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance)
{
    return refuse(instance, "discrete states are evaluated by fmi3UpdateDiscreteStates");
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *need_update,
                                    fmi3Boolean *terminate, fmi3Boolean *nominals_changed,
                                    fmi3Boolean *states_changed, fmi3Boolean *next_defined,
                                    fmi3Float64 *next)
{
    Component *c = instance;
    if (!update_discrete_states(&c->model, states_changed, next))
        return report(c);
    *need_update = *nominals_changed = fmi3False;
    *terminate = c->model.now.ended;
    *next_defined = *next < DBL_MAX;
    return fmi3OK;
}

/* Model Exchange */

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance)
{
    ((Component *)instance)->model.now.phase = CONTINUOUS;
    return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean state_stays,
                                       fmi3Boolean *enter_event_mode, fmi3Boolean *terminate)
{
    (void)state_stays;
    history_record(&((Component *)instance)->model);
    *enter_event_mode = *terminate = fmi3False;
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time)
{
    Component *c = instance;
    c->model.now.values[TIME] = time;
    instance_changed(&c->model);
    return fmi3OK;
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 x[], size_t n)
{
    Component *c = instance;
    return status_of(c, set_states(&c->model, x, n));
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 x[], size_t n)
{
    Component *c = instance;
    return status_of(c, get_states(&c->model, x, n));
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[],
                                             size_t n)
{
    Component *c = instance;
    return status_of(c, get_derivatives(&c->model, derivatives, n));
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 indicators[], size_t n)
{
    Component *c = instance;
    return status_of(c, get_indicators(&c->model, indicators, n));
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[],
                                             size_t n)
{
    Component *c = instance;
    return status_of(c, get_nominals(&c->model, nominals, n));
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *n)
{
    (void)instance;
    *n = N_RELATIONS;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *n)
{
    (void)instance;
    *n = N_STATES;
    return fmi3OK;
}

/* Co-Simulation */

fmi3Status fmi3EnterStepMode(fmi3Instance instance)
{
    ((Component *)instance)->model.now.phase = CONTINUOUS;
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 time, fmi3Float64 step,
                      fmi3Boolean no_set_state, fmi3Boolean *event, fmi3Boolean *terminate,
                      fmi3Boolean *early_return, fmi3Float64 *last_time)
{
    (void)no_set_state;
    Component *c = instance;
    const bool succeeded = do_step(&c->model, time, step);
    *terminate = c->model.now.ended;
    *event = c->model.is_paused;
    *last_time = c->model.now.values[TIME];
    *early_return = (*event || *terminate) && *last_time < time + step;
    return status_of(c, succeeded);
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                                    const fmi3Int32 orders[], fmi3Float64 values[],
                                    size_t n_values)
{
    (void)vr, (void)orders, (void)values, (void)n_values;
    return n == 0 ? fmi3OK : refuse(instance, "derivatives of outputs are not provided");
}

/* What the model does not have: structural parameters, clocks, partitions */

fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance)
{
    return refuse(instance, "the model has no structural parameters");
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance)
{
    return refuse(instance, "the model has no structural parameters");
}

#define CLOCK_FUNCTION(name, ...)                                                                  \
    fmi3Status fmi3##name(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,          \
                          __VA_ARGS__)                                                             \
    {                                                                                              \
        (void)vr;                                                                                  \
        return n == 0 ? fmi3OK : refuse(instance, "the model has no clocks");                      \
    }

CLOCK_FUNCTION(GetClock, fmi3Clock values[])
CLOCK_FUNCTION(SetClock, const fmi3Clock values[])
CLOCK_FUNCTION(GetIntervalDecimal, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
CLOCK_FUNCTION(GetIntervalFraction, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
               fmi3IntervalQualifier qualifiers[])
CLOCK_FUNCTION(GetShiftDecimal, fmi3Float64 shifts[])
CLOCK_FUNCTION(GetShiftFraction, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
CLOCK_FUNCTION(SetIntervalDecimal, const fmi3Float64 intervals[])
CLOCK_FUNCTION(SetIntervalFraction, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
CLOCK_FUNCTION(SetShiftDecimal, const fmi3Float64 shifts[])
CLOCK_FUNCTION(SetShiftFraction, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])

fmi3Status fmi3ActivateModelPartition(fmi3Instance instance, fmi3ValueReference clock,
                                      fmi3Float64 time)
{
    (void)clock, (void)time;
    return refuse(instance, "the model has no partitions");
}
