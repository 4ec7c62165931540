/* A hand-written FMI 1.0 FMU, Co-Simulation and Model Exchange: x' = rate (u - x), y = x, n counts
 * steps. With held inputs its Co-Simulation is exact. rate < 0 is refused. */
#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#define API(name) __attribute__((visibility("default"))) name
#define F(name) API(Foreign1_fmi##name)
enum { OK, WARNING, DISCARD, ERROR, FATAL };

typedef struct { void *logger, *allocate, *free, *finished; } SlaveCallbacks;
typedef struct { void *logger, *allocate, *free; } ModelCallbacks;
typedef struct { char iterate, references, values, terminate, has_next; double next; } EventInfo;
typedef struct { double u, rate, time, x; int n; } M;

static M *made(void) { M *m = calloc(1, sizeof(M)); m->rate = 2; m->x = 1; return m; }
static double *real(M *m, unsigned r) { return r == 0 ? &m->u : r == 1 ? &m->x : r == 2 ? &m->rate : NULL; }

const char *F(GetVersion)(void) { return "1.0"; }
const char *F(GetTypesPlatform)(void) { return "standard32"; }
const char *F(GetModelTypesPlatform)(void) { return "standard32"; }
int F(SetDebugLogging)(void *c, char on) { return OK; }
int F(GetReal)(void *c, const unsigned r[], size_t n, double v[]) {
    for (size_t i = 0; i < n; i++)
        if (r[i] == 4) v[i] = ((M *)c)->rate * (((M *)c)->u - ((M *)c)->x);
        else if (real(c, r[i])) v[i] = *real(c, r[i]);
        else return ERROR;
    return OK; }
int F(SetReal)(void *c, const unsigned r[], size_t n, const double v[]) {
    for (size_t i = 0; i < n; i++) { if (!real(c, r[i])) return ERROR; *real(c, r[i]) = v[i]; }
    return OK; }
int F(GetInteger)(void *c, const unsigned r[], size_t n, int v[]) {
    for (size_t i = 0; i < n; i++) v[i] = ((M *)c)->n;
    return OK; }
int F(SetInteger)(void *c, const unsigned r[], size_t n, const int v[]) { return n ? ERROR : OK; }
int F(GetBoolean)(void *c, const unsigned r[], size_t n, char v[]) { return n ? ERROR : OK; }
int F(SetBoolean)(void *c, const unsigned r[], size_t n, const char v[]) { return n ? ERROR : OK; }
int F(GetString)(void *c, const unsigned r[], size_t n, const char *v[]) { return n ? ERROR : OK; }
int F(SetString)(void *c, const unsigned r[], size_t n, const char *const v[]) { return n ? ERROR : OK; }

void *F(InstantiateSlave)(const char *name, const char *guid, const char *place, const char *mime,
                          double timeout, char visible, char interactive, SlaveCallbacks f, char log) { return made(); }
int F(InitializeSlave)(void *c, double start, char stops, double stop) { ((M *)c)->time = start; return ((M *)c)->rate < 0 ? ERROR : OK; }
int F(TerminateSlave)(void *c) { return OK; }
int F(ResetSlave)(void *c) { M *fresh = made(); memcpy(c, fresh, sizeof(M)); free(fresh); return OK; }
void F(FreeSlaveInstance)(void *c) { free(c); }
int F(SetRealInputDerivatives)(void *c, const unsigned r[], size_t n, const int o[], const double v[]) { return ERROR; }
int F(GetRealOutputDerivatives)(void *c, const unsigned r[], size_t n, const int o[], double v[]) { return ERROR; }
int F(CancelStep)(void *c) { return ERROR; }
int F(DoStep)(void *c, double t, double h, char fresh) {
    M *m = c;
    m->x = m->u + (m->x - m->u) * exp(-m->rate * h);
    m->time = t + h;
    m->n++;
    return OK; }
int F(GetStatus)(void *c, int k, int *v) { return DISCARD; }
int F(GetRealStatus)(void *c, int k, double *v) { return DISCARD; }
int F(GetIntegerStatus)(void *c, int k, int *v) { return DISCARD; }
int F(GetBooleanStatus)(void *c, int k, char *v) { return DISCARD; }
int F(GetStringStatus)(void *c, int k, const char **v) { return DISCARD; }

void *F(InstantiateModel)(const char *name, const char *guid, ModelCallbacks f, char log) { return made(); }
void F(FreeModelInstance)(void *c) { free(c); }
int F(SetTime)(void *c, double t) { ((M *)c)->time = t; return OK; }
int F(SetContinuousStates)(void *c, const double x[], size_t n) { ((M *)c)->x = x[0]; return OK; }
int F(CompletedIntegratorStep)(void *c, char *call) { *call = 0; return OK; }
int F(Initialize)(void *c, char controlled, double tolerance, EventInfo *e) {
    memset(e, 0, sizeof *e); e->iterate = 1; return ((M *)c)->rate < 0 ? ERROR : OK; }
int F(GetDerivatives)(void *c, double d[], size_t n) { d[0] = ((M *)c)->rate * (((M *)c)->u - ((M *)c)->x); return OK; }
int F(GetEventIndicators)(void *c, double z[], size_t n) { return OK; }
int F(EventUpdate)(void *c, char results, EventInfo *e) { memset(e, 0, sizeof *e); e->iterate = 1; return OK; }
int F(GetContinuousStates)(void *c, double x[], size_t n) { x[0] = ((M *)c)->x; return OK; }
int F(GetNominalContinuousStates)(void *c, double x[], size_t n) { x[0] = 1; return OK; }
int F(GetStateValueReferences)(void *c, unsigned r[], size_t n) { r[0] = 1; return OK; }
int F(Terminate)(void *c) { return OK; }
