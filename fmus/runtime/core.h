/* The part of an FMU that does not depend on the version of FMI: values, events, delays and the
 * integrator of one instance of one model.
 *
 * The model itself is in the generated file model.h. Everything is compiled as one translation
 * unit (the FMI layer includes core.c) and everything but the FMI functions is static, so several
 * FMUs can also be linked into one program. There are no global variables, and nothing is
 * allocated after an instance has been created.
 */
#ifndef TWINPROOF_CORE_H
#define TWINPROOF_CORE_H

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <string.h>

#include "model.h"

/* C has no empty arrays. */
#define ROOM(n) ((n) > 0 ? (n) : 1)

/* A value reference is an index into `values`, which is laid out in these parts. */
enum {
    TIME = 0,
    PARAMETERS = 1,
    INPUTS = PARAMETERS + N_PARAMETERS,
    STATES = INPUTS + N_INPUTS,
    DISCRETES = STATES + N_STATES,
    DERIVATIVES = DISCRETES + N_DISCRETES, /* from here on computed from what stands before */
    OTHERS = DERIVATIVES + N_STATES,
    N_VALUES = OTHERS + N_OTHERS
};

/* Relative tolerance of the integrator, unless the importer sets one. */
#define DEFAULT_TOLERANCE 1e-8

/* A relation switches when its indicator has passed zero by this much, so that one event cannot be
 * found twice. */
#define EVENT_WIDTH 1e-10

/* Samples that a delay can remember; beyond, it remembers them less densely. */
#define HISTORY_ROOM 4096

typedef struct {
    double time;
    double value;
    double slope; /* time derivative of the value, towards later times */
} Sample;

/* What one delay operator remembers of its operand, in a ring. */
typedef struct {
    int first;
    int count;
    double passed;    /* jumps of the operand up to this time have come out of the delay */
    double next_jump; /* time of the first one that has not, or DBL_MAX */
    Sample samples[ROOM(N_DELAYS) == N_DELAYS ? HISTORY_ROOM : 1];
} History;

/* Where the state slides along a switching surface (see sliding.c). */
typedef struct {
    int relation;  /* whose indicator stays constant */
    double level;  /* of the indicator, as sliding began */
    bool switches[ROOM(N_RELATIONS)]; /* the relations that differ between both sides */
} Surface;

typedef enum { CREATED, INITIALISING, EVENTS, CONTINUOUS, TERMINATED } Phase;

/* Everything that changes while an instance lives. It holds no pointers: getting, setting and
 * serialising the state of an FMU are copies of this. */
typedef struct {
    Phase phase;
    double values[N_VALUES];
    double slopes[ROOM(N_INPUTS)]; /* of the inputs, within the present communication step */
    double relations[ROOM(N_RELATIONS)]; /* 0 or 1, frozen between events */
    double triggers[ROOM(N_TRIGGERS)];   /* when-conditions, as of the last event */
    double loops[ROOM(N_LOOPS)];         /* solutions of the nonlinear blocks at `loops_time` */
    double loops_time;
    double tolerance;
    double step;       /* that the integrator tries next; 0 if it does not know yet */
    bool is_stiff;     /* the method for stiff models is in use */
    int steps_for;     /* steps of late that speak for the other method */
    int steps_against; /* steps of late that do not */
    bool ended;        /* by the model itself, by terminate() */
    bool started;      /* states have been computed from start values */
    int sliding;       /* number of surfaces */
    Surface surfaces[ROOM(N_RELATIONS)];
    bool computed;     /* values from DERIVATIVES on belong to the others */
    History histories[ROOM(N_DELAYS)];
} State;

typedef struct {
    State now;
    char message[256]; /* what went wrong last */
    double indicators[ROOM(N_RELATIONS)]; /* as last asked for by their value references */
    bool pauses_at_events; /* the importer wants to take part in each */
    bool is_paused;        /* at one */
} Instance;

/* All functions that can fail return false and leave a message. */

/* core.c */
static void instance_reset(Instance *m);
static bool instance_initialise(Instance *m);
static void instance_changed(Instance *m);
static bool instance_compute(Instance *m);
static bool is_settable(const Instance *m, size_t value_reference);
static bool fail(Instance *m, const char *format, ...);

/* What the generated functions depend on. `x` may be a trial of the integrator. */
typedef struct {
    double time;
    const double *states;
    double inputs[ROOM(N_INPUTS)];
    double delayed[ROOM(N_DELAYS)];
    double relations[ROOM(N_RELATIONS)];
    double loops[ROOM(N_LOOPS)]; /* solved for; not numbers where there is no solution */
} Point;

static Point point_at(Instance *m, double time, const double *states);
static Point point_now(Instance *m);
static void evaluate_derivatives(Instance *m, double time, const double *x, double *derivatives);
static void evaluate_indicators(Instance *m, const Point *at, double *indicators);

/* Generated functions take arrays of pointers, in the order of model.h. */
#define CALL(function, results, ...)                                                               \
    do {                                                                                           \
        const double *arguments_[] = {__VA_ARGS__};                                                \
        double *results_[] = {results};                                                            \
        function(arguments_, results_, NULL, NULL, 0);                                             \
    } while (0)

#define AT(m, point)                                                                               \
    &(point)->time, (point)->states, (point)->inputs, (m)->now.values + PARAMETERS,                \
        (m)->now.values + DISCRETES, (point)->delayed, (point)->relations, (point)->loops

/* loops.c */
static void solve_loops(Instance *m, Point *at);
static void remember_loops(Instance *m, const Point *at);
static bool loops_are_solved(Instance *m, const Point *at);

/* linear.c */
static bool factorise(int n, double *A, int *pivots);
static void substitute(int n, const double *factors, const int *pivots, double *b);
static bool solve_linear(int n, double *A, double *b);

/* sliding.c */
static bool is_on_surface(const Instance *m, int relation);
static void leave_surfaces(Instance *m, const double *indicators);
static void enter_surface(Instance *m, const double *before, const double *indicators);

/* history.c */
static void history_reset(Instance *m);
static void history_record(Instance *m);
static void history_record_at(Instance *m, double time, const double *states);
static void history_lookup(Instance *m, Point *at);
static double history_next_jump(Instance *m);
static void history_pass_jumps(Instance *m);
static double history_longest_step(Instance *m);

/* events.c */
static void relations_refresh(Instance *m, const double *indicators);
static bool relations_switched(Instance *m, double time, const double *states);
static void event_margins(Instance *m, double time, const double *states, double *margins);
static void event_indicators(Instance *m, double *indicators);
static bool events_update(Instance *m);
static bool events_at_start(Instance *m);
static bool discrete_update(Instance *m);
static bool assertions_hold(Instance *m, const Point *at);

/* solver.c */
static bool solver_advance(Instance *m, double end);

#endif
