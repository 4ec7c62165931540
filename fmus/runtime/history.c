/* Delay operators: what they remember, and what comes out of them.
 *
 * Between samples the operand is interpolated by cubic Hermite polynomials. A jump of the operand
 * is two samples at the same time; it comes out of the delay as an event, exactly.
 */

static Sample *sample(History *h, int index)
{
    return &h->samples[(h->first + index) % HISTORY_ROOM];
}

static void evaluate_delays(Instance *m, const Point *at, double *operands, double *slopes)
{
    const double *arguments[] = {AT(m, at), m->now.slopes};
    double *results[] = {operands, slopes};
    model_delays(arguments, results, NULL, NULL, 0);
}

static void evaluate_durations(Instance *m, double *durations)
{
    CALL(model_durations, durations, m->now.values + PARAMETERS);
}

static void history_reset(Instance *m)
{
    for (int i = 0; i < N_DELAYS; i++) {
        m->now.histories[i].count = 0;
        m->now.histories[i].passed = -DBL_MAX;
        m->now.histories[i].next_jump = DBL_MAX;
    }
    history_record(m);
}

static void append(History *h, Sample new, double duration)
{
    /* Forget what no longer comes out. */
    while (h->count >= 2 && sample(h, 1)->time < new.time - duration)
        h->first = (h->first + 1) % HISTORY_ROOM, h->count--;
    /* With steps far shorter than the delay, keep only samples that are a fraction of it apart. */
    if (h->count >= 2 && new.time - sample(h, h->count - 2)->time < 4 * duration / HISTORY_ROOM)
        h->count--;
    if (h->count == HISTORY_ROOM)
        h->first = (h->first + 1) % HISTORY_ROOM, h->count--;
    *sample(h, h->count++) = new;
}

/* Remember the values of all operands at a time and state. */
static void history_record_at(Instance *m, double time, const double *states)
{
    if (N_DELAYS == 0)
        return;
    double operands[ROOM(N_DELAYS)], slopes[ROOM(N_DELAYS)], durations[ROOM(N_DELAYS)];
    const Point at = point_at(m, time, states);
    evaluate_delays(m, &at, operands, slopes);
    evaluate_durations(m, durations);
    for (int i = 0; i < N_DELAYS; i++) {
        History *h = &m->now.histories[i];
        const Sample new = {time, operands[i], slopes[i]};
        if (h->count > 0 && sample(h, h->count - 1)->time >= time) {
            Sample *newest = sample(h, h->count - 1);
            const double scale = fabs(newest->value) + fabs(new.value);
            /* At the start there is no past that the value could jump from. */
            const bool replaces = h->count == 1 || sample(h, h->count - 2)->time == newest->time;
            if (replaces || fabs(new.value - newest->value) <= 1e-13 * scale) {
                *newest = new;
            } else if (h->count < HISTORY_ROOM) {
                *sample(h, h->count++) = new;
                h->next_jump = fmin(h->next_jump, new.time);
            }
        } else {
            append(h, new, durations[i]);
        }
    }
}

static void history_record(Instance *m)
{
    history_record_at(m, m->now.values[TIME], m->now.values + STATES);
}

static double hermite(const Sample *a, const Sample *b, double time)
{
    const double h = b->time - a->time, s = (time - a->time) / h, r = 1 - s;
    return (1 + 2 * s) * r * r * a->value + s * s * (3 - 2 * s) * b->value
           + h * s * r * (r * a->slope - s * b->slope);
}

/* Index of the first sample at `time` or later; `count` if there is none. */
static int first_from(History *h, double time)
{
    int low = 0, high = h->count;
    while (low < high) {
        const int middle = (low + high) / 2;
        if (sample(h, middle)->time < time)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

/* Value at `time`; beyond the newest sample, `present` is the operand at `present_time`. */
static double recall(History *h, double time, double present_time, double present)
{
    if (time >= h->next_jump)
        return sample(h, first_from(h, h->next_jump))->value;
    time = fmax(time, h->passed);
    const Sample *newest = sample(h, h->count - 1);
    if (time >= newest->time) {
        const double span = present_time - newest->time;
        if (span <= 0)
            return newest->value;
        const double s = (time - newest->time) / span;
        /* The parabola through both values with the slope of the older one. */
        return newest->value + span * s * newest->slope
               + s * s * (present - newest->value - span * newest->slope);
    }
    /* Of a jump at this very time, the newer side. */
    int after = first_from(h, time);
    while (sample(h, after)->time == time)
        after++;
    return after == 0 ? sample(h, 0)->value : hermite(sample(h, after - 1), sample(h, after), time);
}

/* Fill in what comes out of the delays at a point. */
static void history_lookup(Instance *m, Point *at)
{
    if (N_DELAYS == 0 || m->now.histories[0].count == 0)
        return;
    double operands[ROOM(N_DELAYS)] = {0}, slopes[ROOM(N_DELAYS)], durations[ROOM(N_DELAYS)];
    bool beyond = false;
    evaluate_durations(m, durations);
    for (int i = 0; i < N_DELAYS; i++) {
        History *h = &m->now.histories[i];
        beyond = beyond || at->time - durations[i] > sample(h, h->count - 1)->time;
    }
    /* Twice if the present values of the operands matter: they may depend on other delays. */
    for (int pass = 0; pass < (beyond ? 2 : 1); pass++) {
        if (beyond)
            evaluate_delays(m, at, operands, slopes);
        for (int i = 0; i < N_DELAYS; i++)
            at->delayed[i] =
                recall(&m->now.histories[i], at->time - durations[i], at->time, operands[i]);
    }
}

/* Time at which the next jump comes out of a delay. */
static double history_next_jump(Instance *m)
{
    double next = DBL_MAX, durations[ROOM(N_DELAYS)];
    if (N_DELAYS > 0)
        evaluate_durations(m, durations);
    for (int i = 0; i < N_DELAYS; i++)
        if (m->now.histories[i].next_jump < DBL_MAX)
            next = fmin(next, fmax(m->now.histories[i].next_jump + durations[i],
                                   m->now.values[TIME]));
    return next;
}

static double jump_after(History *h, double time)
{
    for (int i = first_from(h, time); i + 1 < h->count; i++)
        if (sample(h, i)->time > time && sample(h, i)->time == sample(h, i + 1)->time)
            return sample(h, i)->time;
    return DBL_MAX;
}

/* Let those jumps out whose time has come. */
static void history_pass_jumps(Instance *m)
{
    const double time = m->now.values[TIME];
    const double reached = time + 4 * DBL_EPSILON * fabs(time);
    double durations[ROOM(N_DELAYS)];
    if (N_DELAYS > 0)
        evaluate_durations(m, durations);
    for (int i = 0; i < N_DELAYS; i++) {
        History *h = &m->now.histories[i];
        while (h->next_jump < DBL_MAX && h->next_jump + durations[i] <= reached) {
            h->passed = h->next_jump;
            h->next_jump = jump_after(h, h->passed);
        }
    }
}

/* A step must not need what it has not computed; very short delays are interpolated instead. */
static double history_longest_step(Instance *m)
{
    double longest = DBL_MAX, durations[ROOM(N_DELAYS)];
    if (N_DELAYS > 0)
        evaluate_durations(m, durations);
    for (int i = 0; i < N_DELAYS; i++)
        longest = fmin(longest, fmax(durations[i], 1e-4));
    return longest;
}
