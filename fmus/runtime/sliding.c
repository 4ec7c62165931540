/* Sliding along a switching surface, as where dry friction holds a mass at rest.
 *
 * Where a relation switches and the derivatives on both sides lead back to the surface, no solution
 * crosses it. The state then moves along the surface, by the mean of both sides' derivatives that
 * keeps the indicator constant: A. F. Filippov, Differential Equations with Discontinuous Righthand
 * Sides (1988), chapter 2. Several surfaces at once are solved together, as if each added its own
 * part to the derivatives.
 */

typedef int Function(const double **, double **, int *, double *, int);

/* Far beyond what separates the sides of a surface, and far below what anybody would see. */
#define SLIDING_WIDTH (10 * EVENT_WIDTH)

/* The same point on the other side of a surface. */
static Point beyond(Instance *m, const Surface *surface, const Point *at)
{
    Point other = *at;
    for (int i = 0; i < N_RELATIONS; i++)
        if (surface->switches[i])
            other.relations[i] = !(at->relations[i] > 0);
    solve_loops(m, &other);
    return other;
}

/* Rate of change of an indicator along given derivatives. */
static double indicator_rate(Instance *m, const Point *at, const double *derivatives, int relation)
{
    const double span = 1e-6;
    double x[ROOM(N_STATES)], here[ROOM(N_RELATIONS)], there[ROOM(N_RELATIONS)];
    for (int i = 0; i < N_STATES; i++)
        x[i] = at->states[i] + span * derivatives[i];
    Point next = *at;
    next.time += span;
    next.states = x;
    for (int i = 0; i < N_INPUTS; i++)
        next.inputs[i] += span * m->now.slopes[i];
    solve_loops(m, &next);
    evaluate_indicators(m, at, here);
    evaluate_indicators(m, &next, there);
    return (there[relation] - here[relation]) / span;
}

/* For each surface, the share of its other side that keeps all indicators constant. */
static void sliding_shares(Instance *m, const Point *at, double *shares)
{
    const int n = m->now.sliding < N_RELATIONS ? m->now.sliding : N_RELATIONS;
    double base[ROOM(N_STATES)], other[ROOM(N_STATES)];
    double A[ROOM(N_RELATIONS) * ROOM(N_RELATIONS)];
    CALL(model_derivatives, base, AT(m, at));
    for (int i = 0; i < n; i++)
        shares[i] = -indicator_rate(m, at, base, m->now.surfaces[i].relation);
    for (int j = 0; j < n; j++) {
        const Point across = beyond(m, &m->now.surfaces[j], at);
        CALL(model_derivatives, other, AT(m, &across));
        for (int i = 0; i < n; i++)
            A[i + j * n] =
                indicator_rate(m, at, other, m->now.surfaces[i].relation)
                - indicator_rate(m, at, base, m->now.surfaces[i].relation);
    }
    if (!solve_linear(n, A, shares))
        memset(shares, 0, n * sizeof(double));
    /* Outside these limits one side leads away, and the state leaves the surface by it. */
    for (int i = 0; i < n; i++)
        shares[i] = fmin(fmax(shares[i], 0), 1);
}

/* Evaluate a generated function of n results, with both sides of the surfaces mixed. */
static void evaluate(Instance *m, Function *function, int n, const Point *at, double *result)
{
    CALL(function, result, AT(m, at));
    if (N_RELATIONS == 0 || m->now.sliding == 0)
        return;
    double shares[ROOM(N_RELATIONS)];
    double base[ROOM(N_STATES + N_OTHERS)], other[ROOM(N_STATES + N_OTHERS)];
    sliding_shares(m, at, shares);
    memcpy(base, result, n * sizeof(double));
    for (int k = 0; k < m->now.sliding; k++) {
        const Point across = beyond(m, &m->now.surfaces[k], at);
        CALL(function, other, AT(m, &across));
        for (int i = 0; i < n; i++)
            result[i] += shares[k] * (other[i] - base[i]);
    }
}

static double distance_from(const Surface *surface, const double *indicators)
{
    return fabs(indicators[surface->relation] - surface->level);
}

static bool is_on_surface(const Instance *m, int relation)
{
    for (int k = 0; k < m->now.sliding; k++)
        if (m->now.surfaces[k].switches[relation])
            return true;
    return false;
}

/* Let those surfaces go that the state has left. */
static void leave_surfaces(Instance *m, const double *indicators)
{
    int kept = 0;
    for (int k = 0; k < m->now.sliding; k++) {
        const Surface surface = m->now.surfaces[k];
        if (distance_from(&surface, indicators) <= SLIDING_WIDTH)
            m->now.surfaces[kept++] = surface;
    }
    m->now.sliding = kept;
}

/* After relations have switched: does the new side lead back? Then stay on the surface. */
static void enter_surface(Instance *m, const double *before, const double *indicators)
{
    State *s = &m->now;
    Surface surface = {.relation = -1};
    for (int i = 0; i < N_RELATIONS; i++) {
        surface.switches[i] = (before[i] > 0) != (s->relations[i] > 0);
        if (surface.switches[i] && surface.relation < 0)
            surface.relation = i;
    }
    if (surface.relation < 0 || N_STATES == 0 || s->sliding == ROOM(N_RELATIONS))
        return;
    double here[ROOM(N_STATES)], there[ROOM(N_STATES)];
    const Point at = point_now(m), across = beyond(m, &surface, &at);
    surface.level = indicators[surface.relation];
    evaluate(m, model_derivatives, N_STATES, &at, here);
    evaluate(m, model_derivatives, N_STATES, &across, there);
    const double direction = s->relations[surface.relation] > 0 ? 1 : -1;
    const double back = direction * indicator_rate(m, &at, here, surface.relation);
    const double forth = direction * indicator_rate(m, &at, there, surface.relation);
    if (back < -SLIDING_WIDTH && forth > SLIDING_WIDTH)
        s->surfaces[s->sliding++] = surface;
}
