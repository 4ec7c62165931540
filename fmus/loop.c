/* The stepping loop over one FMU or several connected ones, for FMI 1, 2 and 3 Co-Simulation.
 *
 * All inputs of all units stand in one array `u`, all outputs in one array `y`; `source` says where
 * an input comes from. Numbers are double here; groups convert from and to the FMU's own types. */

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stddef.h>
#include <string.h>

enum { FLOAT64, FLOAT32, INT8, UINT8, INT16, UINT16, INT32, UINT32, INT64, UINT64 };
enum { SETTING = 1, GETTING, STEPPING, SLOPES, SAVING, RESTORING, ENDED };
enum { UNCONNECTED = INT32_MIN };

/* Variables of one type, set or read with one call. */
typedef struct {
    void *function;
    const uint32_t *references;
    const int32_t *places; /* in `u` or `y` */
    void *buffer;
    int32_t type, n;
} Group;

typedef struct {
    void *component, *do_step, *get_state, *set_state, *set_slopes;
    const Group *inputs, *outputs;
    int32_t version, n_inputs, n_outputs; /* numbers of groups */
    int32_t first, last;                  /* its inputs are u[first] to u[last - 1] */
} Unit;

typedef struct {
    const Unit *units;
    const int32_t *order, *source; /* order: units, sources first */
    const int32_t *owner;          /* the unit of each output */
    const double *factor, *offset; /* of the connection to each input */
    double *u, *y, *before;        /* before: the inputs at the previous point */
    double *rise;                  /* of the inputs since then, without jumps at this point */
    double *ahead;                 /* the inputs of a step */
    uint8_t *stepped;              /* which units have done the present step */
    int32_t n_units, n_u, failed_unit, failed_at, status;
    int32_t has_before;
    double span; /* between the previous point and this one */
    const int32_t *plus; /* column from outside that is added to each input, or -1; NULL: none */
    const double *grid;  /* resolution of each input, or 0; NULL: none */
    int32_t sampled;     /* outputs are only read where a point is settled */
} System;

typedef int Access(void *, const uint32_t *, size_t, void *);
typedef int Access3(void *, const uint32_t *, size_t, void *, size_t);
typedef int Step(void *, double, double, int);
typedef int Step3(void *, double, double, bool, bool *, bool *, bool *, double *);
typedef int State(void *, void *);
typedef int Slopes(void *, const uint32_t *, size_t, const int *, const double *);

static bool passed(System *s, int32_t unit, int at, int status)
{
    if (status <= 1)
        return true;
    s->failed_unit = unit, s->failed_at = at, s->status = status;
    return false;
}

static int access(const Unit *unit, const Group *g)
{
    const size_t n = (size_t)g->n;
    if (unit->version == 3)
        return ((Access3 *)g->function)(unit->component, g->references, n, g->buffer, n);
    return ((Access *)g->function)(unit->component, g->references, n, g->buffer);
}

#define EACH(Type, statement)                                                                      \
    for (int32_t i = 0; i < g->n; i++) {                                                           \
        Type *b = (Type *)g->buffer + i;                                                           \
        double *v = values + g->places[i];                                                         \
        statement;                                                                                 \
    }                                                                                              \
    break
#define CONVERT(put)                                                                               \
    switch (g->type) {                                                                             \
    case FLOAT64: EACH(double, put(double));                                                       \
    case FLOAT32: EACH(float, put(float));                                                         \
    case INT8: EACH(int8_t, put(int8_t));                                                          \
    case UINT8: EACH(uint8_t, put(uint8_t));                                                       \
    case INT16: EACH(int16_t, put(int16_t));                                                       \
    case UINT16: EACH(uint16_t, put(uint16_t));                                                    \
    case INT32: EACH(int32_t, put(int32_t));                                                       \
    case UINT32: EACH(uint32_t, put(uint32_t));                                                    \
    case INT64: EACH(int64_t, put(int64_t));                                                       \
    case UINT64: EACH(uint64_t, put(uint64_t));                                                    \
    }
#define TO_FMU(Type) *b = (Type)*v
#define FROM_FMU(Type) (void)sizeof(Type), *v = (double)*b

static bool set(System *s, int32_t k, double *values)
{
    const Unit *unit = s->units + k;
    for (int32_t j = 0; j < unit->n_inputs; j++) {
        const Group *g = unit->inputs + j;
        CONVERT(TO_FMU)
        if (!passed(s, k, SETTING, access(unit, g)))
            return false;
    }
    return true;
}

static bool get(System *s, int32_t k, double *values)
{
    const Unit *unit = s->units + k;
    for (int32_t j = 0; j < unit->n_outputs; j++) {
        const Group *g = unit->outputs + j;
        if (!passed(s, k, GETTING, access(unit, g)))
            return false;
        CONVERT(FROM_FMU)
    }
    return true;
}

static void gather(System *s, const Unit *unit, const double *external)
{
    for (int32_t i = unit->first; i < unit->last; i++) {
        const int32_t from = s->source[i];
        if (from >= 0)
            s->u[i] = s->factor[i] * s->y[from] + s->offset[i];
        else if (from != UNCONNECTED)
            s->u[i] = s->factor[i] * external[-1 - from] + s->offset[i];
        if (s->plus != NULL && s->plus[i] >= 0)
            s->u[i] += external[s->plus[i]];
        if (s->grid != NULL && s->grid[i] > 0)
            s->u[i] = s->grid[i] * nearbyint(s->u[i] / s->grid[i]);
    }
}

static bool step(System *s, int32_t k, double time, double length)
{
    const Unit *unit = s->units + k;
    if (unit->version != 3) /* FMI 1: a new step; FMI 2: it may be taken back */
        return passed(s, k, STEPPING,
                      ((Step *)unit->do_step)(unit->component, time, length, unit->version == 1));
    bool event = false, ended = false, early = false;
    double reached = time;
    const int status = ((Step3 *)unit->do_step)(unit->component, time, length, false, &event,
                                                &ended, &early, &reached);
    return passed(s, k, STEPPING, status) && passed(s, k, ENDED, ended ? 3 : 0);
}

/* Set the inputs of one unit from outside, and read its outputs. */
bool loop_evaluate(System *s, int32_t k)
{
    return set(s, k, s->u) && get(s, k, s->y);
}

bool loop_read(System *s)
{
    for (int32_t k = 0; k < s->n_units; k++)
        if (!get(s, k, s->y))
            return false;
    return true;
}

/* At one point in time: outputs to inputs, sources first. */
bool loop_settle(System *s, const double *external)
{
    for (int32_t i = 0; i < s->n_units; i++) {
        const int32_t k = s->order[i];
        gather(s, s->units + k, external);
        if (!set(s, k, s->u) || !get(s, k, s->y))
            return false;
    }
    return true;
}

/* Inputs of a unit for the step to come. Of order 1: as they are now. Of order 2: at the middle of
 * the step, on the line through the last two points, or between old and new where the source has
 * stepped already. */
static void prepare(System *s, const Unit *unit, double length, int32_t order, const uint8_t *stepped,
                    double *ahead)
{
    const double reach = order == 2 && s->has_before ? 0.5 * length / s->span : 0;
    for (int32_t i = unit->first; i < unit->last; i++) {
        const int32_t from = s->source[i];
        const double old = s->u[i];
        if (from < 0)
            ahead[i] = old;
        else if (stepped[s->owner[from]]) {
            const double new = s->factor[i] * s->y[from] + s->offset[i];
            ahead[i] = order == 2 ? 0.5 * (old + new) : new;
        } else
            ahead[i] = old + reach * s->rise[i];
    }
}

/* One step of all units from a settled point: Jacobi, all from the values of that point; or
 * Gauss-Seidel (`sequential`), where a unit sees the new outputs of those before it. */
bool loop_advance(System *s, double time, double length, int32_t sequential, int32_t order)
{
    const bool several = s->n_units > 1;
    memset(s->stepped, 0, (size_t)s->n_units);
    memcpy(s->ahead, s->u, (size_t)s->n_u * sizeof(double));
    for (int32_t i = 0; i < s->n_units; i++) {
        const int32_t k = s->order[i];
        if (several && (order == 2 || sequential)) {
            prepare(s, s->units + k, length, order, s->stepped, s->ahead);
            if (!set(s, k, s->ahead))
                return false;
        }
        if (!step(s, k, time, length) || (sequential && !get(s, k, s->y)))
            return false;
        s->stepped[k] = (uint8_t)(sequential != 0);
    }
    memcpy(s->before, s->u, (size_t)s->n_u * sizeof(double));
    s->has_before = 1, s->span = length;
    return sequential || !several || s->sampled || loop_read(s);
}

/* Hold the inputs of a single unit over a step, and read its outputs at the end of it: what a
 * controller that is not compiled needs of each of its cycles, in one call. */
bool loop_tick(System *s, const double *external, double time, double length, double *outputs)
{
    const Unit *unit = s->units;
    gather(s, unit, external);
    return set(s, 0, s->u) && step(s, 0, time, length) && get(s, 0, outputs);
}

/* Settle at a point where inputs from outside may jump. A line through the last two points must not
 * lean on the jump: what happened until just before it counts. */
static bool arrive(System *s, const double *last, const double *external, size_t n_external)
{
    const bool jumps = last != NULL && memcmp(last, external, n_external * sizeof(double)) != 0;
    if (!loop_settle(s, jumps ? last : external))
        return false;
    for (int32_t i = 0; i < s->n_u; i++)
        s->rise[i] = s->u[i] - s->before[i];
    return !jumps || loop_settle(s, external);
}

/* A run over `n` points; returns how many were reached.
 *
 * external (n, inputs from outside), slopes likewise or NULL (one unit, FMI 2), recorded (n) or
 * NULL for all, results (recorded points, n_shown): y at `shown`. */
int64_t loop_run(System *s, int64_t n, const double *times, const double *external,
                 int64_t n_external, const double *slopes, const uint8_t *recorded, double *results,
                 const int32_t *shown, int64_t n_shown, int32_t sequential, int32_t order)
{
    int ones[64];
    for (int i = 0; i < 64; i++)
        ones[i] = 1;
    if (s->n_units > 1 && !loop_read(s)) /* outputs that depend on no input must be there first */
        return 0;
    for (int64_t k = 0; k < n; k++) {
        const double *row = external + k * n_external;
        const bool is_shown = recorded == NULL || recorded[k];
        if (s->n_units > 1) {
            const bool leans = order == 2 && k > 0;
            if (!arrive(s, leans ? row - n_external : NULL, row, (size_t)n_external))
                return k;
        } else {
            gather(s, s->units, row);
            if (!set(s, 0, s->u) || (is_shown && !get(s, 0, s->y)))
                return k;
        }
        if (is_shown) {
            for (int64_t i = 0; i < n_shown; i++)
                results[i] = s->y[shown[i]];
            results += n_shown;
        }
        if (k + 1 == n)
            break;
        if (slopes != NULL && s->units->n_inputs == 1 && n_external <= 64) {
            const Unit *unit = s->units;
            const int status = ((Slopes *)unit->set_slopes)(
                unit->component, unit->inputs->references, (size_t)n_external, ones,
                slopes + k * n_external);
            if (!passed(s, 0, SLOPES, status))
                return k;
        }
        if (!loop_advance(s, times[k], times[k + 1] - times[k], sequential, order))
            return k;
    }
    return n;
}

/* Every unit's state, for a step that may be taken back. */
bool loop_save(System *s, void **states)
{
    for (int32_t k = 0; k < s->n_units; k++)
        if (!passed(s, k, SAVING,
                    ((State *)s->units[k].get_state)(s->units[k].component, states + k)))
            return false;
    return true;
}

bool loop_restore(System *s, void **states)
{
    for (int32_t k = 0; k < s->n_units; k++)
        if (!passed(s, k, RESTORING,
                    ((State *)s->units[k].set_state)(s->units[k].component, states[k])))
            return false;
    return true;
}
