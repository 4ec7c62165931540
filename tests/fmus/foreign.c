/* A hand-written FMI 2.0 Co-Simulation FMU: x' = u - x by Euler's method, y = x; `misdeed` breaks things. */
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <netinet/in.h>
#include <unistd.h>
#include <errno.h>
typedef struct { double u, x, misdeed; } M;
#define API __attribute__((visibility("default")))
API const char *fmi2GetTypesPlatform(void) { return "default"; }
API const char *fmi2GetVersion(void) { return "2.0"; }
API int fmi2SetDebugLogging(void *c, int on, size_t n, const char *const k[]) { return 0; }
API void *fmi2Instantiate(const char *name, int type, const char *guid, const char *res, const void *cb, int visible, int log) { return calloc(1, sizeof(M)); }
API void fmi2FreeInstance(void *c) { free(c); }
API int fmi2SetupExperiment(void *c, int td, double tol, double start, int sd, double stop) { return 0; }
API int fmi2EnterInitializationMode(void *c) { return 0; }
API int fmi2ExitInitializationMode(void *c) { return 0; }
API int fmi2Terminate(void *c) { return 0; }
API int fmi2Reset(void *c) { memset(c, 0, sizeof(M)); return 0; }
API int fmi2GetReal(void *c, const unsigned r[], size_t n, double v[]) {
    M *m = c; for (size_t i = 0; i < n; i++) v[i] = r[i] == 0 ? m->u : r[i] == 1 ? m->x : m->misdeed; return 0; }
API int fmi2SetReal(void *c, const unsigned r[], size_t n, const double v[]) {
    M *m = c; for (size_t i = 0; i < n; i++) *(r[i] == 0 ? &m->u : r[i] == 1 ? &m->x : &m->misdeed) = v[i]; return 0; }
#define NONE(T, t) API int fmi2Get##T(void *c, const unsigned r[], size_t n, t v[]) { return n ? 3 : 0; } \
    API int fmi2Set##T(void *c, const unsigned r[], size_t n, const t v[]) { return n ? 3 : 0; }
NONE(Integer, int) NONE(Boolean, int) NONE(String, char *)
API int fmi2GetFMUstate(void *c, void **s) { if (!*s) *s = malloc(sizeof(M)); memcpy(*s, c, sizeof(M)); return 0; }
API int fmi2SetFMUstate(void *c, void *s) { memcpy(c, s, sizeof(M)); return 0; }
API int fmi2FreeFMUstate(void *c, void **s) { free(*s); *s = NULL; return 0; }
API int fmi2SerializedFMUstateSize(void *c, void *s, size_t *n) { *n = sizeof(M); return 0; }
API int fmi2SerializeFMUstate(void *c, void *s, char b[], size_t n) { memcpy(b, s, n); return 0; }
API int fmi2DeSerializeFMUstate(void *c, const char b[], size_t n, void **s) { *s = malloc(n); memcpy(*s, b, n); return 0; }
API int fmi2GetDirectionalDerivative(void *c, const unsigned a[], size_t na, const unsigned b[], size_t nb, const double s[], double d[]) { return 3; }
API int fmi2SetRealInputDerivatives(void *c, const unsigned r[], size_t n, const int o[], const double v[]) { return 3; }
API int fmi2GetRealOutputDerivatives(void *c, const unsigned r[], size_t n, const int o[], double v[]) { return 3; }
API int fmi2CancelStep(void *c) { return 3; }
API int fmi2GetStatus(void *c, int k, int *v) { return 3; }
API int fmi2GetRealStatus(void *c, int k, double *v) { return 3; }
API int fmi2GetIntegerStatus(void *c, int k, int *v) { return 3; }
API int fmi2GetBooleanStatus(void *c, int k, int *v) { return 3; }
API int fmi2GetStringStatus(void *c, int k, char **v) { return 3; }

static int misdeed(int kind) {
    static char block[1 << 20];
    switch (kind) {
    case 1: *(volatile int *)0 = 1; return 0;                  /* crash */
    case 2: for (;;) usleep(1000); return 0;                   /* hang */
    case 3: for (;;) { char *p = malloc(1 << 26); if (!p) return 3; memset(p, 1, 1 << 26); }
    case 4: exit(7);
    case 5: { FILE *f = fopen("big", "wb"); for (int i = 0; i < 4096; i++) if (fwrite(block, sizeof block, 1, f) != 1) return 3; return 0; }
    case 6: for (int i = 0; i < 4096; i++) if (open("/dev/null", O_RDONLY) < 0) return 3; return 0;
    case 7: {                                                  /* is there a network? */
        struct sockaddr_in a = {.sin_family = AF_INET, .sin_port = htons(9), .sin_addr.s_addr = htonl(0x7f000001)};
        int s = socket(AF_INET, SOCK_STREAM, 0);
        if (s < 0) return 0;
        int r = connect(s, (struct sockaddr *)&a, sizeof a), e = errno; close(s);
        return r < 0 && e == ENETUNREACH ? 3 : 0; }
    case 8: for (int i = 0; i < 1000; i++) puts("noise on standard output"); return 0;
    case 9: for (int i = 3; i < 64; i++) { long long n = 1ll << 40; (void)!write(i, &n, 8); } exit(0);
    }
    return 0;
}
API int fmi2DoStep(void *c, double t, double h, int p) {
    M *m = c; if (m->misdeed != 0) { int s = misdeed((int)m->misdeed); if (s) return s; }
    m->x += h * (m->u - m->x); return 0; }
