/* Integration with error control, location of events, and choice of the method.
 *
 * Control of the step size as in E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential
 * Equations I, II.4.
 */

/* More than this within one communication step is a fault of the model or of its tolerance. */
enum { MOST_STEPS = 10000000, MOST_EVENTS = 100000 };

/* So many steps in turn must speak for the other method, and so many against it end the count. */
enum { STEPS_FOR = 15, STEPS_AGAINST = 6 };

/* A trial step from the present time and state. */
typedef struct {
    double size;
    double slope[ROOM(N_STATES)]; /* derivatives at its begin */
    double end[ROOM(N_STATES)];   /* states at its end */
    double end_slope[ROOM(N_STATES)];
    double dense[3][ROOM(N_STATES)]; /* the interpolating polynomial, see location.c */
    bool is_limited; /* stability rather than accuracy limits, or would limit, explicit steps */
    /* For the stiff method, about the begin of the step: */
    bool is_linearised;
    double jacobian[ROOM(N_STATES * N_STATES)]; /* by columns */
    double trend[ROOM(N_STATES)];               /* partial derivative by time */
    double fastest;                             /* a bound of the rates of the model */
} Step;

static double scale(const Instance *m, int i, double a, double b)
{
    return m->now.tolerance * (1e-2 * model_nominals[i] + fmax(fabs(a), fabs(b)));
}

#include "dormand_prince.c"
#include "rosenbrock.c"
#include "location.c"

/* Try a step; its slope is given. Returns the scaled error, wanted <= 1. */
static double try_step(Instance *m, Step *step, double size)
{
    step->size = size;
    return m->now.is_stiff ? rosenbrock(m, step) : dormand_prince(m, step);
}

/* The factor by which a step may change that had this error. */
static double growth(const Instance *m, double error)
{
    return 0.9 * pow(fmax(error, 1e-8), m->now.is_stiff ? -1. / 4 : -1. / 5);
}

/* After an accepted step: is the other method the better one? */
static void choose_method(Instance *m, const Step *step)
{
    State *s = &m->now;
    if (N_STATES == 0)
        return;
    if (step->is_limited != s->is_stiff) {
        s->steps_for++;
        s->steps_against = 0;
    } else if (++s->steps_against >= STEPS_AGAINST) {
        s->steps_for = 0;
    }
    if (s->steps_for >= STEPS_FOR) {
        s->is_stiff = !s->is_stiff;
        s->steps_for = s->steps_against = 0;
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

/* Begin anew at the present time and state. */
static void restart(Instance *m, Step *step)
{
    evaluate_derivatives(m, m->now.values[TIME], m->now.values + STATES, step->slope);
    step->is_linearised = false;
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
        if (!isfinite(step->end[i]) && N_LOOPS > 0)
            return fail(m, "the nonlinear equations for '%s' lose their solution at time %.9g",
                        model_loop_names[0], m->now.values[TIME]);
        else if (!isfinite(step->end[i]))
            return fail(m, "the state '%s' leaves the finite numbers at time %.9g",
                        model_state_names[i], m->now.values[TIME]);
    return fail(m, "no step is short enough for the tolerance at time %.9g", m->now.values[TIME]);
}

/* Integrate to `end`, with all events on the way, or until the first if the importer wants so. */
static bool solver_advance(Instance *m, double end)
{
    State *s = &m->now;
    double *x = s->values + STATES;
    Step step;
    int events = 0;
    m->is_paused = false;

    /* Inputs may have jumped since the last call. */
    history_pass_jumps(m);
    history_record(m);
    if (relations_switched(m, s->values[TIME], x) && !events_update(m))
        return false;
    restart(m, &step);

    for (int run = 0; s->values[TIME] < end && !s->ended; run++) {
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
                s->step = first_step(m, step.slope, left);
            double size = fmin(fmin(s->step, history_longest_step(m)), left);
            if (size > 0.99 * left)
                size = left;
            const double error = try_step(m, &step, size);
            if (!(error <= 1)) { /* also if it is not a number */
                s->step = size * (error < 1e30 ? fmax(0.2, growth(m, error)) : 0.1);
                if (s->step < tiny)
                    return too_small(m, &step);
                continue;
            }
            const double factor = fmin(5, growth(m, error));
            const double theta = N_RELATIONS == 0 ? 1 : locate_event(m, &step);
            bool stopped = theta == 1 && size == left;
            if (theta < 1) {
                /* Go to the event by a step of full accuracy rather than by interpolation. */
                size = fmax(theta * size, tiny);
                try_step(m, &step, size);
            } else if (size >= s->step || factor < 1) {
                s->step = size * factor; /* a clipped step says nothing about longer ones */
                choose_method(m, &step);
            }
            const bool switched = relations_switched(m, time + size, step.end);
            record_within(m, &step);
            move_to(m, stopped ? stop : time + size);
            memcpy(x, step.end, N_STATES * sizeof(double));
            if (!(switched || (stopped && jump <= stop))) {
                history_record(m);
                memcpy(step.slope, step.end_slope, sizeof step.slope);
                step.is_linearised = false;
                continue;
            }
            events++;
        }
        history_record(m); /* left of the event */
        if (m->pauses_at_events) {
            m->is_paused = true;
            return true;
        }
        if (!events_update(m))
            return false;
        restart(m, &step);
    }
    return true;
}
