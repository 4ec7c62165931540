/* Where within a step the first relation switches. */

/* State at the fraction `theta` of a step. */
static void interpolate(const Instance *m, const Step *step, double theta, double *y)
{
    const double *x = m->now.values + STATES, rest = 1 - theta;
    for (int i = 0; i < N_STATES; i++) {
        const double inner = step->dense[1][i] + rest * step->dense[2][i];
        const double bend = step->dense[0][i] + theta * inner;
        y[i] = x[i] + theta * (step->end[i] - x[i] + rest * bend);
    }
}

/* The relations at a fraction of a step: negative where one has switched. */
typedef struct {
    double theta;
    double margins[ROOM(N_RELATIONS)];
} Look;

static Look look_at(Instance *m, const Step *step, double theta)
{
    Look look = {.theta = theta};
    double y[ROOM(N_STATES)];
    interpolate(m, step, theta, y);
    event_margins(m, m->now.values[TIME] + theta * step->size, y, look.margins);
    return look;
}

static bool has_switched(const Look *look)
{
    for (int i = 0; i < N_RELATIONS; i++)
        if (look->margins[i] < 0)
            return true;
    return false;
}

/* The parabola g0 + s (b + c s) through three values at s = 0, 1/2 and 1. */
typedef struct {
    double start, slope, bend;
} Parabola;

static Parabola parabola(double start, double middle, double end)
{
    return (Parabola){start, 4 * middle - 3 * start - end, 2 * (start + end) - 4 * middle};
}

static double height(const Parabola *p, double s)
{
    return p->start + s * (p->slope + s * p->bend);
}

/* Place of the least value between 0 and 1. */
static double lowest(const Parabola *p)
{
    const double vertex = p->bend > 0 ? -p->slope / (2 * p->bend) : 0;
    if (vertex > 0 && vertex < 1)
        return vertex;
    return p->slope + p->bend < 0 ? 1 : 0;
}

/* Do five equidistant looks exclude that a margin falls below zero and rises again unseen? */
static bool is_resolved(const Look looks[5], int relation)
{
    double g[5];
    for (int k = 0; k < 5; k++)
        g[k] = looks[k].margins[relation];
    const Parabola p = parabola(g[0], g[2], g[4]);
    const double error = fmax(fabs(height(&p, 0.25) - g[1]), fabs(height(&p, 0.75) - g[3]));
    const double first = p.slope, last = p.slope + 2 * p.bend;
    const bool is_monotonic = first * last > 0 && fmin(fabs(first), fabs(last)) > 16 * error;
    return is_monotonic || height(&p, lowest(&p)) >= 2 * error;
}

/* Halving a step so many times, it is hardly likely that anything has been overlooked. */
enum { FINEST_HALVING = 6 };

/* Find two fractions of a step, before and after a relation has switched first. */
static bool bracket(Instance *m, const Step *step, const Look *from, const Look *to, int halvings,
                    double *before, double *after)
{
    Look looks[5] = {[0] = *from, [4] = *to};
    const double span = to->theta - from->theta;
    bool resolved = true;
    for (int k = 1; k < 4; k++)
        looks[k] = look_at(m, step, from->theta + k * span / 4);
    for (int i = 0; i < N_RELATIONS; i++)
        resolved = resolved && is_resolved(looks, i);
    if (!resolved && halvings > 0)
        return bracket(m, step, &looks[0], &looks[2], halvings - 1, before, after)
               || bracket(m, step, &looks[2], &looks[4], halvings - 1, before, after);
    for (int k = 1; k < 5; k++) {
        if (has_switched(&looks[k])) {
            *before = looks[k - 1].theta;
            *after = looks[k].theta;
            return true;
        }
    }
    for (int i = 0; !resolved && i < N_RELATIONS; i++) {
        const Parabola p =
            parabola(looks[0].margins[i], looks[2].margins[i], looks[4].margins[i]);
        const Look least = look_at(m, step, from->theta + lowest(&p) * span);
        if (has_switched(&least)) {
            *before = from->theta;
            *after = least.theta;
            return true;
        }
    }
    return false;
}

/* Fraction of a step just after its first event, or 1 if there is none before the end. */
static double locate_event(Instance *m, const Step *step)
{
    const double time = m->now.values[TIME];
    const double width = 4 * DBL_EPSILON * fmax(fabs(time), step->size) / step->size;
    const Look from = look_at(m, step, 0), to = look_at(m, step, 1);
    double before, after;
    if (!bracket(m, step, &from, &to, FINEST_HALVING, &before, &after))
        return 1;
    while (after - before > width) {
        const double middle = (before + after) / 2;
        if (middle <= before || middle >= after)
            break;
        const Look look = look_at(m, step, middle);
        if (has_switched(&look))
            after = middle;
        else
            before = middle;
    }
    return after;
}
