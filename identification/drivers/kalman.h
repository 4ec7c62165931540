/* The extended Kalman filter's parts. Before this stand the generated functions of the model and its
   sizes: NX states, NU inputs (the last ND of them delayed signals), NS sensitive parameters, the
   first `nd` of which vary as first-order Gauss-Markov processes (disturbances); NY outputs, WORK
   doubles of scratch. m = NX + nd everywhere; z (m) is the mean, P (m x m, symmetric) its covariance. */
#include <math.h>
#include <string.h>
enum { NZ = NX + NS };

static inline int bounded(int m, const double *z) {
  for (int i = 0; i < m; i++)
    if (!(z[i] > -1e12 && z[i] < 1e12)) return 0;
  return 1;
}

/* y, C = dy/dx, D = dy/ds at z, with the nd disturbances put into p where they belong. */
static inline void observe(int nd, double t, const double *z, const double *u, const int *where, double *p,
                           double *y, double *C, double *D) {
  const double *arg[4] = {&t, z, u, p};
  double *res[3] = {y, C, D}, w[WORK];
  for (int j = 0; j < nd; j++) p[where[j]] = z[NX + j];
  twinproof_output_sensitive(arg, res, 0, w, 0);
}

/* Linearises output i about the mean z0 that y, C (NY x NX) and D (NY x NS) were found at: row (m), and
   ph = P row'. Returns the innovation; *S, the sensor's variance at first, leaves as that of it. */
static inline double innovation(int m, int i, double measured, const double *y, const double *C,
                                const double *D, const double *z, const double *z0, const double *P,
                                double *row, double *ph, double *S) {
  double e = measured - y[i];
  int j, l;
  for (l = 0; l < NX; l++) row[l] = C[l * NY + i];
  for (l = 0; l < m - NX; l++) row[NX + l] = D[l * NY + i];
  for (l = 0; l < m; l++) e -= row[l] * (z[l] - z0[l]);
  for (l = 0; l < m; l++) {
    double a = 0;
    for (j = 0; j < m; j++) a += P[l * m + j] * row[j];
    ph[l] = a;
  }
  for (l = 0; l < m; l++) *S += row[l] * ph[l];
  return e;
}

/* Takes one scalar measurement, with innovation e of variance S; gain (m) is kept for the caller. */
static inline void correct(int m, double e, double S, const double *ph, double *gain, double *z, double *P) {
  int j, l;
  for (l = 0; l < m; l++) gain[l] = ph[l] / S;
  for (l = 0; l < m; l++) z[l] += gain[l] * e;
  for (l = 0; l < m; l++) /* symmetric by construction */
    for (j = 0; j <= l; j++) P[l * m + j] = P[j * m + l] = P[l * m + j] - gain[l] * ph[j];
  for (l = 0; l < m; l++)
    if (P[l * m + l] < 1e-300) P[l * m + l] = 1e-300;
}

/* Inputs a share of the sample interval after uk; held where ramps[] is 0, delayed signals never are. */
static inline void inputs_at(double share, const double *uk, const double *un, const int *ramps, double *u) {
  for (int i = 0; i < NU; i++)
    u[i] = uk[i] + share * (i < NU - ND && !ramps[i] ? 0 : un[i] - uk[i]);
}

/* Integration step b of a sample interval of `substeps` that begins at t: the states x with A = dx/dx and
   B = dx/ds. */
static inline void step(int b, int substeps, double t, double hs, const double *z, const double *uk,
                        const double *un, const int *ramps, const double *p, double *x, double *A, double *B) {
  double ts = t + b * hs, ua[NU + 1], ub[NU + 1], w[WORK];
  const double *arg[6] = {&ts, z, ua, ub, p, &hs};
  double *res[3] = {x, A, B};
  inputs_at((double)b / substeps, uk, un, ramps, ua);
  inputs_at((double)(b + 1) / substeps, uk, un, ramps, ub);
  twinproof_step_sensitive(arg, res, 0, w, 0);
}

/* F (NX x m) <- A F + [0 B]: dx/d(x, d) of one more step. G: scratch of the same size. */
static inline void chain(int m, const double *A, const double *B, double *F, double *G) {
  int i, j, l;
  for (i = 0; i < NX; i++)
    for (j = 0; j < m; j++) {
      double a = j < NX ? 0 : B[(j - NX) * NX + i];
      for (l = 0; l < NX; l++) a += A[l * NX + i] * F[l * m + j];
      G[i * m + j] = a;
    }
  memcpy(F, G, NX * m * sizeof(double));
}

/* P <- [F; 0 phi] P [F; 0 phi]' + Q, and the disturbances' means decay. phi, q (nd): decay over a sample
   and the variance that a sample adds; qx (NX): variance that a sample adds to each state. */
static inline void predict(int m, const double *F, const double *phi, const double *q, const double *qx,
                           double *T, double *G, double *z, double *P) {
  const int nd = m - NX;
  int i, j, l;
  for (i = 0; i < NX; i++)
    for (j = 0; j < m; j++) {
      double a = 0;
      for (l = 0; l < m; l++) a += F[i * m + l] * P[l * m + j];
      T[i * m + j] = a;
    }
  for (i = 0; i < NX; i++)
    for (j = 0; j <= i; j++) {
      double a = 0;
      for (l = 0; l < m; l++) a += T[i * m + l] * F[j * m + l];
      G[i * m + j] = a;
    }
  for (i = 0; i < NX; i++) {
    for (j = 0; j <= i; j++) P[i * m + j] = P[j * m + i] = G[i * m + j];
    P[i * m + i] += qx[i];
    for (j = 0; j < nd; j++) P[i * m + NX + j] = P[(NX + j) * m + i] = T[i * m + NX + j] * phi[j];
  }
  for (i = 0; i < nd; i++) {
    for (j = 0; j < nd; j++) P[(NX + i) * m + NX + j] *= phi[i] * phi[j];
    P[(NX + i) * m + NX + i] += q[i];
    z[NX + i] *= phi[i];
  }
}
