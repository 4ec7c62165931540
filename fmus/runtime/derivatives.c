/* Partial derivatives of what an instance computes, exact within the present situation: relations
 * and what comes out of delays are held, since neither depends on the values of this instant.
 */

/* The part of a direction that acts on states: as long as the model is being initialised, these
 * follow from start values, parameters and initial equations. */
static bool seed_states(Instance *m, const double *seed, double *states)
{
    memcpy(states, seed + STATES, N_STATES * sizeof(double));
    if (m->now.phase > INITIALISING)
        return true;
    if (!instance_initialise(m))
        return false;
    const Point at = point_now(m);
    if (N_STATES > 0) {
        double started[ROOM(N_STATES + N_DISCRETES)];
        CALL(model_start_directional, started, m->now.values + PARAMETERS,
             m->now.values + STATES, seed + PARAMETERS, seed + STATES);
        memcpy(states, started, N_STATES * sizeof(double));
    }
    if (N_INITIAL > 0) {
        /* Where the residual stays zero: jacobian · change of the free states = - its change. */
        double residual[ROOM(N_INITIAL)], jacobian[ROOM(N_INITIAL * N_INITIAL)];
        const double *arguments[] = {AT(m, &at)};
        double *results[] = {residual, jacobian};
        model_initial(arguments, results, NULL, NULL, 0);
        for (int i = 0; i < N_INITIAL; i++)
            states[model_initial_states[i]] = 0;
        CALL(model_initial_directional, residual, AT(m, &at), states, seed + INPUTS,
             seed + PARAMETERS);
        if (!solve_linear(N_INITIAL, jacobian, residual))
            return fail(m, "the initial equations do not determine the derivative");
        for (int i = 0; i < N_INITIAL; i++)
            states[model_initial_states[i]] = -residual[i];
    }
    return true;
}

/* A direction through all values, and event indicators after them: given are parameters, inputs
 * and states; the rest is filled in. */
static bool complete_direction(Instance *m, double *direction)
{
    double states[ROOM(N_STATES)];
    if (!seed_states(m, direction, states))
        return false;
    const Point at = point_now(m);
    const double *inputs = direction + INPUTS, *parameters = direction + PARAMETERS;
    if (N_STATES + N_OTHERS > 0)
        CALL(model_directional, direction + DERIVATIVES, AT(m, &at), states, inputs, parameters);
    if (N_RELATIONS > 0)
        CALL(model_indicators_directional, direction + N_VALUES, AT(m, &at), states, inputs,
             parameters);
    memcpy(direction + STATES, states, N_STATES * sizeof(double));
    return true;
}

static bool is_known(size_t value_reference)
{
    return value_reference >= PARAMETERS && value_reference < DISCRETES;
}

/* Check the unknowns and knowns that an importer names. */
static bool is_derivative(Instance *m, const unsigned *unknowns, size_t n_unknowns,
                          const unsigned *knowns, size_t n_knowns)
{
    for (size_t i = 0; i < n_knowns; i++)
        if (!is_known(knowns[i]))
            return fail(m, "derivatives exist by parameters, inputs and continuous states");
    for (size_t i = 0; i < n_unknowns; i++)
        if (unknowns[i] >= N_VALUES + N_RELATIONS)
            return fail(m, "there is no value reference %u", unknowns[i]);
    return true;
}

/* Jacobian of unknowns by knowns, times `seed`. */
static bool directional_derivative(Instance *m, const unsigned *unknowns, size_t n_unknowns,
                                   const unsigned *knowns, size_t n_knowns, const double *seed,
                                   double *sensitivity)
{
    double direction[N_VALUES + N_RELATIONS] = {0};
    if (!is_derivative(m, unknowns, n_unknowns, knowns, n_knowns))
        return false;
    for (size_t i = 0; i < n_knowns; i++)
        direction[knowns[i]] = seed[i];
    if (!complete_direction(m, direction))
        return false;
    for (size_t i = 0; i < n_unknowns; i++)
        sensitivity[i] = direction[unknowns[i]];
    return true;
}
