/* Relations, when-clauses and their iteration. */

/* The indicator of a relation is positive where it holds. On a surface there is nothing to decide. */
static void relations_refresh(Instance *m, const double *indicators)
{
    for (int i = 0; i < N_RELATIONS; i++)
        if (!is_on_surface(m, i))
            m->now.relations[i] = model_is_strict[i] ? indicators[i] > 0 : indicators[i] >= 0;
}

/* How far each relation is from switching, at a trial of the integrator; negative beyond. */
static void event_margins(Instance *m, double time, const double *states, double *margins)
{
    double indicators[ROOM(N_RELATIONS)];
    const Point at = point_at(m, time, states);
    evaluate_indicators(m, &at, indicators);
    for (int i = 0; i < N_RELATIONS; i++) {
        const double distance = m->now.relations[i] > 0 ? indicators[i] : -indicators[i];
        /* On a surface nothing switches, except that the surface may be left. */
        margins[i] = EVENT_WIDTH + (is_on_surface(m, i) ? 0 : distance);
    }
    for (int k = 0; k < m->now.sliding; k++) {
        const Surface *surface = &m->now.surfaces[k];
        margins[surface->relation] = SLIDING_WIDTH - distance_from(surface, indicators);
    }
}

/* Has any relation switched, at a trial of the integrator? */
static bool relations_switched(Instance *m, double time, const double *states)
{
    double margins[ROOM(N_RELATIONS)];
    if (N_RELATIONS > 0)
        event_margins(m, time, states, margins);
    for (int i = 0; i < N_RELATIONS; i++)
        if (margins[i] < 0)
            return true;
    return false;
}

/* What importers watch for a change of sign. */
static void event_indicators(Instance *m, double *indicators)
{
    event_margins(m, m->now.values[TIME], m->now.values + STATES, indicators);
    for (int i = 0; i < N_RELATIONS; i++)
        if (!is_on_surface(m, i) && !(m->now.relations[i] > 0))
            indicators[i] = -indicators[i];
}

static bool assertions_hold(Instance *m, const Point *at)
{
    if (N_ASSERTIONS == 0)
        return true;
    double holds[ROOM(N_ASSERTIONS)];
    CALL(model_assertions, holds, AT(m, at));
    for (int i = 0; i < N_ASSERTIONS; i++)
        if (!(holds[i] > 0))
            return fail(m, "at time %.9g: %s", at->time, model_assertion_messages[i]);
    return true;
}

/* Apply when-clauses and equations of discrete variables. Returns whether anything has changed. */
static bool act(Instance *m, const Point *at, const double *fired)
{
    double changed[ROOM(N_STATES + N_DISCRETES)];
    double *present = m->now.values + STATES;
    const size_t size = (N_STATES + N_DISCRETES) * sizeof(double);
    CALL(model_actions, changed, AT(m, at), fired);
    const bool has_changed = memcmp(present, changed, size) != 0;
    memcpy(present, changed, size);
    return has_changed;
}

/* Bring discrete variables up to date, without any when-clause. */
static bool discrete_update(Instance *m)
{
    const double fired[ROOM(N_TRIGGERS)] = {0};
    if (N_DISCRETE_EQUATIONS == 0)
        return false;
    const Point at = point_now(m);
    return act(m, &at, fired);
}

/* Apply the clauses `when initial()`. */
static bool events_at_start(Instance *m)
{
    double fired[ROOM(N_TRIGGERS)];
    bool any = false;
    for (int i = 0; i < N_TRIGGERS; i++) {
        fired[i] = model_at_start[i];
        any = any || model_at_start[i];
    }
    if (any) {
        const Point at = point_now(m);
        act(m, &at, fired);
    }
    return true;
}

/* Event iteration: update relations and fire when-clauses until nothing changes. */
static bool events_update(Instance *m)
{
    State *s = &m->now;
    double indicators[ROOM(N_RELATIONS)], relations[ROOM(N_RELATIONS)], before[ROOM(N_RELATIONS)];
    double triggers[ROOM(N_TRIGGERS)], fired[ROOM(N_TRIGGERS)] = {0};
    bool acted = false;
    s->computed = false;
    memcpy(before, s->relations, sizeof before);
    history_pass_jumps(m);
    for (int pass = 0; pass < 100; pass++) {
        Point at = point_now(m);
        evaluate_indicators(m, &at, indicators);
        leave_surfaces(m, indicators);
        memcpy(relations, s->relations, sizeof relations);
        relations_refresh(m, indicators);
        bool settled = memcmp(relations, s->relations, sizeof relations) == 0, any = false;
        memcpy(at.relations, s->relations, sizeof at.relations);
        solve_loops(m, &at);
        if (N_TRIGGERS > 0)
            CALL(model_triggers, triggers, AT(m, &at));
        for (int i = 0; i < N_TRIGGERS; i++) {
            fired[i] = triggers[i] > 0 && !(s->triggers[i] > 0);
            any = any || fired[i] > 0;
            s->triggers[i] = triggers[i];
            if (fired[i] > 0 && model_terminates[i][0] != 0) {
                fail(m, "%s", model_terminates[i]); /* no failure, but worth a message */
                s->ended = true;
            }
        }
        if (any || N_DISCRETE_EQUATIONS > 0) {
            const bool jumped = act(m, &at, fired);
            settled = settled && !any && !jumped;
            acted = acted || any || jumped;
        }
        if (settled) {
            if (!acted)
                enter_surface(m, before, indicators);
            history_record(m); /* an operand may have jumped */
            const Point after = point_now(m);
            return loops_are_solved(m, &after) && assertions_hold(m, &after);
        }
    }
    return fail(m, "the events at time %.9g do not settle: one sets off the other for ever",
                s->values[TIME]);
}
