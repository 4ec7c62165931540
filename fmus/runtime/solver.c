/* Dormand-Prince 5(4) with error control, dense output and location of events.
 *
 * J. R. Dormand, P. J. Prince, A family of embedded Runge-Kutta formulae, J. Comp. Appl. Math. 6
 * (1980) 19-26; dense output and step control as in E. Hairer, S. P. Norsett, G. Wanner, Solving
 * Ordinary Differential Equations I, II.4-II.6.
 */

enum { STAGES = 7 };

static const double NODES[STAGES] = {0, 1. / 5, 3. / 10, 4. / 5, 8. / 9, 1, 1};
static const double WEIGHTS[STAGES][STAGES - 1] = {
    {0},
    {1. / 5},
    {3. / 40, 9. / 40},
    {44. / 45, -56. / 15, 32. / 9},
    {19372. / 6561, -25360. / 2187, 64448. / 6561, -212. / 729},
    {9017. / 3168, -355. / 33, 46732. / 5247, 49. / 176, -5103. / 18656},
    {35. / 384, 0, 500. / 1113, 125. / 192, -2187. / 6784, 11. / 84},
};
static const double ERROR[STAGES] = {71. / 57600,      0,          -71. / 16695, 71. / 1920,
                                     -17253. / 339200, 22. / 525,  -1. / 40};
static const double DENSE[STAGES] = {-12715105075. / 11282082432,  0,
                                     87487479700. / 32700410799,   -10690763975. / 1880347072,
                                     701980252875. / 199316789632, -1453857185. / 822651844,
                                     69997945. / 29380423};

/* More than this within one communication step is a fault of the model or of its tolerance. */
enum { MOST_STEPS = 10000000, MOST_EVENTS = 100000 };

typedef struct {
    double stages[STAGES][ROOM(N_STATES)];
    double end[ROOM(N_STATES)];
    double size;
} Step;

static double scale(const Instance *m, int i, double a, double b)
{
    return m->now.tolerance * (1e-2 * model_nominals[i] + fmax(fabs(a), fabs(b)));
}

/* Try a step from the present state; stage 0 is given. Returns the scaled error, wanted <= 1. */
static double try_step(Instance *m, Step *step, double size)
{
    const double time = m->now.values[TIME], *x = m->now.values + STATES;
    double y[ROOM(N_STATES)];
    step->size = size;
    for (int s = 1; s < STAGES; s++) {
        for (int i = 0; i < N_STATES; i++) {
            double sum = 0;
            for (int j = 0; j < s; j++)
                sum += WEIGHTS[s][j] * step->stages[j][i];
            y[i] = x[i] + size * sum;
        }
        evaluate_derivatives(m, time + NODES[s] * size, y, step->stages[s]);
    }
    memcpy(step->end, y, sizeof y);
    double square = 0;
    for (int i = 0; i < N_STATES; i++) {
        double sum = 0;
        for (int s = 0; s < STAGES; s++)
            sum += ERROR[s] * step->stages[s][i];
        sum *= size / scale(m, i, x[i], y[i]);
        square += sum * sum;
    }
    return sqrt(square / ROOM(N_STATES));
}

/* State at the fraction `theta` of a step, accurate to fourth order. */
static void interpolate(const Instance *m, const Step *step, double theta, double *y)
{
    const double *x = m->now.values + STATES;
    for (int i = 0; i < N_STATES; i++) {
        const double h = step->size, rise = step->end[i] - x[i];
        const double bend = h * step->stages[0][i] - rise;
        double sum = 0;
        for (int s = 0; s < STAGES; s++)
            sum += DENSE[s] * step->stages[s][i];
        const double r = 1 - theta;
        y[i] = x[i]
               + theta * (rise
                          + r * (bend
                                 + theta * (rise - h * step->stages[6][i] - bend
                                            + r * h * sum)));
    }
}

/* Delays interpolate between samples: give them some within a step that is long for this. */
static void record_within(Instance *m, const Step *step)
{
    for (int quarter = 1; N_DELAYS > 0 && quarter < 4; quarter++) {
        double y[ROOM(N_STATES)];
        interpolate(m, step, quarter / 4., y);
        history_record_at(m, m->now.values[TIME] + quarter / 4. * step->size, y);
    }
}

static bool switched_within(Instance *m, const Step *step, double theta)
{
    double y[ROOM(N_STATES)];
    interpolate(m, step, theta, y);
    return relations_switched(m, m->now.values[TIME] + theta * step->size, y);
}

/* Fraction of the step just after its first event, or 1 if there is none before the end.
 * A relation that switches forth and back within a quarter of a step is not noticed. */
static double locate_event(Instance *m, const Step *step)
{
    const double time = m->now.values[TIME];
    const double width = 4 * DBL_EPSILON * fmax(fabs(time), step->size) / step->size;
    double before = 0, after = 1;
    for (int quarter = 1; quarter < 4; quarter++) {
        if (switched_within(m, step, quarter / 4.)) {
            after = quarter / 4.;
            break;
        }
        before = quarter / 4.;
    }
    if (after == 1 && !relations_switched(m, time + step->size, step->end))
        return 1;
    while (after - before > width) {
        const double middle = (before + after) / 2;
        if (middle <= before || middle >= after)
            break;
        if (switched_within(m, step, middle))
            after = middle;
        else
            before = middle;
    }
    return after;
}

/* A first guess of the step size, from the size of the states and of their derivatives. */
static double first_step(const Instance *m, const double *derivatives, double longest)
{
    double size = 0, slope = 0;
    if (N_STATES == 0)
        return longest;
    for (int i = 0; i < N_STATES; i++) {
        const double x = m->now.values[STATES + i];
        const double unit = scale(m, i, x, x);
        size += (x / unit) * (x / unit);
        slope += (derivatives[i] / unit) * (derivatives[i] / unit);
    }
    const double guess = size > 0 && slope > 0 ? 0.01 * sqrt(size / slope) : 1e-6;
    return fmin(fmax(guess, 1e-6), longest);
}

static void move_to(Instance *m, double time)
{
    const double elapsed = time - m->now.values[TIME];
    for (int i = 0; i < N_INPUTS; i++)
        m->now.values[INPUTS + i] += elapsed * m->now.slopes[i];
    m->now.values[TIME] = time;
    m->now.computed = false;
}

static bool too_small(Instance *m, const Step *step)
{
    for (int i = 0; i < N_STATES; i++)
        if (!isfinite(step->end[i]))
            return fail(m, "the state '%s' leaves the finite numbers at time %.9g",
                        model_state_names[i], m->now.values[TIME]);
    return fail(m, "no step is short enough for the tolerance at time %.9g", m->now.values[TIME]);
}

/* Integrate to `end`, with all events on the way. */
static bool solver_advance(Instance *m, double end)
{
    State *s = &m->now;
    double *x = s->values + STATES;
    Step step;
    int events = 0;

    /* Inputs may have jumped since the last call. */
    history_pass_jumps(m);
    history_record(m);
    if (relations_switched(m, s->values[TIME], x) && !events_update(m))
        return false;
    evaluate_derivatives(m, s->values[TIME], x, step.stages[0]);

    for (int run = 0; s->values[TIME] < end; run++) {
        const double time = s->values[TIME];
        const double jump = history_next_jump(m);
        const double stop = fmin(end, jump), left = stop - time;
        const double tiny = 16 * DBL_EPSILON * fmax(fabs(time), left);
        if (run == MOST_STEPS)
            return fail(m, "more than %d steps since the last communication, at time %.9g",
                        MOST_STEPS, time);
        if (events > MOST_EVENTS)
            return fail(m, "more than %d events since the last communication, at time %.9g",
                        MOST_EVENTS, time);
        if (left > 0) {
            if (s->step <= 0)
                s->step = first_step(m, step.stages[0], left);
            double size = fmin(fmin(s->step, history_longest_step(m)), left);
            if (size > 0.99 * left)
                size = left;
            const double error = try_step(m, &step, size);
            if (!(error <= 1)) { /* also if it is not a number */
                s->step = size * (error < 1e30 ? fmax(0.2, 0.9 * pow(error, -0.2)) : 0.1);
                if (s->step < tiny)
                    return too_small(m, &step);
                continue;
            }
            const double growth = fmin(5, 0.9 * pow(fmax(error, 1e-8), -0.2));
            const double theta = N_RELATIONS == 0 ? 1 : locate_event(m, &step);
            bool stopped = theta == 1 && size == left;
            if (theta < 1) {
                /* Go to the event by a step of full accuracy rather than by interpolation. */
                size = fmax(theta * size, tiny);
                try_step(m, &step, size);
            } else if (size >= s->step || growth < 1) {
                s->step = size * growth; /* a clipped step says nothing about longer ones */
            }
            const bool switched = relations_switched(m, time + size, step.end);
            record_within(m, &step);
            move_to(m, stopped ? stop : time + size);
            memcpy(x, step.end, N_STATES * sizeof(double));
            if (!(switched || (stopped && jump <= stop))) {
                history_record(m);
                memcpy(step.stages[0], step.stages[STAGES - 1], sizeof step.stages[0]);
                continue;
            }
            events++;
        }
        history_record(m); /* left of the event */
        if (!events_update(m))
            return false;
        evaluate_derivatives(m, s->values[TIME], x, step.stages[0]);
    }
    return true;
}
