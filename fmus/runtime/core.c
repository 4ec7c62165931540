/* Values of an instance: start, change, evaluation. */

#include "core.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

static bool fail(Instance *m, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(m->message, sizeof m->message, format, arguments);
    va_end(arguments);
    return false;
}

static void evaluate_indicators(Instance *m, const Point *at, double *indicators)
{
    indicators[0] = 0; /* there may be none */
    CALL(model_indicators, indicators, AT(m, at));
}

/* Describe the situation at a trial time and state of the integrator. */
static Point point_at(Instance *m, double time, const double *states)
{
    Point at = {.time = time, .states = states};
    const double elapsed = time - m->now.values[TIME];
    for (int i = 0; i < N_INPUTS; i++)
        at.inputs[i] = m->now.values[INPUTS + i] + elapsed * m->now.slopes[i];
    memcpy(at.relations, m->now.relations, sizeof at.relations);
    history_lookup(m, &at);
    solve_loops(m, &at);
    return at;
}

static Point point_now(Instance *m)
{
    const Point at = point_at(m, m->now.values[TIME], m->now.values + STATES);
    remember_loops(m, &at);
    return at;
}

#include "linear.c"
#include "loops.c"
#include "sliding.c"

static void evaluate_derivatives(Instance *m, double time, const double *x, double *derivatives)
{
    if (N_STATES > 0) {
        const Point at = point_at(m, time, x);
        evaluate(m, model_derivatives, N_STATES, &at, derivatives);
    }
}

static void instance_reset(Instance *m)
{
    memset(m, 0, sizeof *m);
    m->now.phase = CREATED;
    m->now.tolerance = DEFAULT_TOLERANCE;
    memcpy(m->now.values + PARAMETERS, model_start_values, sizeof model_start_values);
}

static bool is_settable(const Instance *m, size_t value_reference)
{
    if (value_reference < PARAMETERS || value_reference >= DERIVATIVES)
        return false;
    if (value_reference < INPUTS)
        return model_is_tunable[value_reference - PARAMETERS];
    /* States and discrete variables can be given start values, unless these are computed. */
    if (value_reference >= STATES)
        return m->now.phase == CREATED || m->now.phase == INITIALISING;
    return true;
}

/* Note that the importer has set a value. */
static void instance_changed(Instance *m)
{
    m->now.computed = false;
    if (m->now.phase == CREATED || m->now.phase == INITIALISING)
        m->now.started = false;
}

/* Find the states that the initial equations leave open, by Newton's method. */
static bool solve_initial_equations(Instance *m)
{
    double *x = m->now.values + STATES;
    for (int iteration = 0; iteration < 50; iteration++) {
        const Point at = point_now(m);
        double residual[ROOM(N_INITIAL)], jacobian[ROOM(N_INITIAL * N_INITIAL)], change = 0;
        {
            const double *arguments[] = {AT(m, &at)};
            double *results[] = {residual, jacobian};
            model_initial(arguments, results, NULL, NULL, 0);
        }
        if (!solve_linear(N_INITIAL, jacobian, residual))
            break;
        for (int i = 0; i < N_INITIAL; i++) {
            const int state = model_initial_states[i];
            x[state] -= residual[i];
            change = fmax(change, fabs(residual[i]) / (model_nominals[state] + fabs(x[state])));
        }
        if (change < 1e-13)
            return true;
        if (!isfinite(change))
            break;
    }
    return fail(m, "the initial equations have no solution near the start values");
}

/* Relations, discrete variables and initial equations may depend on each other; a few passes settle
 * them. What sample() asks for happens after the start, what initial() asks for until then. */
static bool settle_start(Instance *m)
{
    State *s = &m->now;
    double indicators[ROOM(N_RELATIONS)], before[ROOM(N_RELATIONS)];
    for (int pass = 0; pass < 20; pass++) {
        if (N_INITIAL > 0 && !solve_initial_equations(m))
            return false;
        const Point at = point_now(m);
        memcpy(before, s->relations, sizeof before);
        evaluate_indicators(m, &at, indicators);
        relations_refresh(m, indicators);
        for (int i = 0; i < N_RELATIONS; i++)
            if (model_is_clock[i] || model_is_initial[i])
                s->relations[i] = model_is_initial[i];
        const bool jumped = discrete_update(m);
        if (!jumped && memcmp(before, s->relations, sizeof before) == 0)
            return loops_are_solved(m, &at);
    }
    return fail(m, "the relations and discrete variables do not settle at the start");
}

/* Compute states, relations and when-conditions from the start values, unless that is done. */
static bool instance_initialise(Instance *m)
{
    State *s = &m->now;
    if (s->started)
        return true;
    double *x = s->values + STATES;
    s->sliding = 0;
    double started[ROOM(N_STATES + N_DISCRETES)];
    if (N_STATES + N_DISCRETES > 0) {
        CALL(model_start, started, s->values + PARAMETERS, x);
        memcpy(x, started, (N_STATES + N_DISCRETES) * sizeof(double));
    }
    history_reset(m);
    s->ended = false;
    s->loops_time = s->values[TIME];
    memset(s->relations, 0, sizeof s->relations);
    if (N_LOOPS > 0)
        memcpy(s->loops, model_loop_starts, sizeof s->loops);
    if (!settle_start(m) || !events_at_start(m) || !settle_start(m))
        return false;
    const Point at = point_now(m);
    if (N_TRIGGERS > 0)
        CALL(model_triggers, s->triggers, AT(m, &at));
    if (!assertions_hold(m, &at))
        return false;
    history_reset(m);
    s->started = true;
    s->computed = false;
    return true;
}

/* Bring the computed values up to date. */
static bool instance_compute(Instance *m)
{
    State *s = &m->now;
    if ((s->phase == CREATED || s->phase == INITIALISING) && !instance_initialise(m))
        return false;
    if (s->computed)
        return true;
    const Point at = point_now(m);
    if (!loops_are_solved(m, &at) || !assertions_hold(m, &at))
        return false;
    if (N_STATES > 0)
        evaluate(m, model_derivatives, N_STATES, &at, s->values + DERIVATIVES);
    if (N_OTHERS > 0)
        evaluate(m, model_others, N_OTHERS, &at, s->values + OTHERS);
    s->computed = true;
    return true;
}

#include "history.c"
#include "events.c"
#include "solver.c"
#include "derivatives.c"
#include "access.c"
