/* What the layers of both FMI versions do with an instance. Value references from N_VALUES on are
 * event indicators. */

/* Bring those values up to date that will be read. */
static bool update_values(Instance *m, const unsigned *references, size_t n)
{
    bool started = false, computed = false, watched = false;
    for (size_t i = 0; i < n; i++) {
        if (references[i] >= N_VALUES + N_RELATIONS)
            return fail(m, "there is no value reference %u", references[i]);
        started = started || references[i] >= STATES; /* may follow from parameters */
        computed = computed || references[i] >= DERIVATIVES;
        watched = watched || references[i] >= N_VALUES;
    }
    if (computed && !instance_compute(m))
        return false;
    if (started && m->now.phase <= INITIALISING && !instance_initialise(m))
        return false;
    if (watched)
        event_indicators(m, m->indicators);
    return true;
}

static double read_value(const Instance *m, unsigned reference)
{
    return reference < N_VALUES ? m->now.values[reference] : m->indicators[reference - N_VALUES];
}

static bool write_value(Instance *m, unsigned reference, double value)
{
    if (!is_settable(m, reference))
        return fail(m, "the value with reference %u cannot be set now", reference);
    m->now.values[reference] = value;
    instance_changed(m);
    return true;
}

static void begin(Instance *m, double start, bool tolerance_defined, double tolerance)
{
    if (tolerance_defined && tolerance > 0)
        m->now.tolerance = fmin(fmax(tolerance, 1e-13), 1e-2);
    m->now.values[TIME] = start;
    instance_changed(m);
}

/* Copy `from`, which is a State or its bytes, to where `*to` points; to new memory if nowhere. */
static bool copy_state(Instance *m, const void *from, void **to)
{
    if (from == NULL)
        return fail(m, "there is no state");
    if (*to == NULL)
        *to = malloc(sizeof(State));
    if (*to == NULL)
        return fail(m, "no memory for the state");
    memcpy(*to, from, sizeof(State));
    return true;
}

static bool has_states(Instance *m, size_t n)
{
    return n == N_STATES || fail(m, "the model has %d continuous states", N_STATES);
}

static bool set_states(Instance *m, const double *states, size_t n)
{
    if (!has_states(m, n))
        return false;
    memcpy(m->now.values + STATES, states, N_STATES * sizeof(double));
    m->now.computed = false;
    return true;
}

static bool get_states(Instance *m, double *states, size_t n)
{
    if (has_states(m, n))
        memcpy(states, m->now.values + STATES, N_STATES * sizeof(double));
    return n == N_STATES;
}

static bool get_derivatives(Instance *m, double *derivatives, size_t n)
{
    if (has_states(m, n))
        evaluate_derivatives(m, m->now.values[TIME], m->now.values + STATES, derivatives);
    return n == N_STATES;
}

static bool get_nominals(Instance *m, double *nominals, size_t n)
{
    if (has_states(m, n))
        memcpy(nominals, model_nominals, N_STATES * sizeof(double));
    return n == N_STATES;
}

static bool get_indicators(Instance *m, double *indicators, size_t n)
{
    if (n != N_RELATIONS)
        return fail(m, "the model has %d event indicators", N_RELATIONS);
    event_indicators(m, indicators);
    return true;
}

static void enter_event_mode(Instance *m)
{
    history_record(m); /* as it is just before the event */
    m->now.phase = EVENTS;
}

/* Handle an event; tell whether states have jumped, and when the next one is due or DBL_MAX. */
static bool update_discrete_states(Instance *m, bool *states_changed, double *next_event)
{
    double before[ROOM(N_STATES)];
    memcpy(before, m->now.values + STATES, N_STATES * sizeof(double));
    if (!events_update(m))
        return false;
    *states_changed = memcmp(before, m->now.values + STATES, N_STATES * sizeof(double)) != 0;
    *next_event = history_next_jump(m);
    return true;
}

/* End the initialisation; without event mode, events at the very start happen at once. */
static bool leave_initialisation(Instance *m, bool has_event_mode)
{
    if (!instance_initialise(m))
        return false;
    m->now.phase = has_event_mode ? EVENTS : CONTINUOUS;
    return has_event_mode || events_update(m);
}

static bool do_step(Instance *m, double time, double step)
{
    if (m->now.phase != CONTINUOUS)
        return fail(m, "a step outside of step mode");
    if (fabs(time - m->now.values[TIME]) > 1e-6 * fmax(step, fabs(time)))
        return fail(m, "a step from time %.9g, but the model is at %.9g", time,
                    m->now.values[TIME]);
    const bool succeeded = solver_advance(m, time + step);
    memset(m->now.slopes, 0, sizeof m->now.slopes);
    return succeeded;
}
