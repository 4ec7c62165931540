/* Extended Kalman filter over states and slowly varying disturbances, with the log-likelihood's parts.
   All NS sensitive parameters are disturbances. */
#include "kalman.h"

/* z (NZ) and P (NZ x NZ, symmetric) hold the prior at the first sample and leave as the last
   prediction. r (NY): sensors' variances; where[NS]: index of each disturbance among the parameters;
   phi, q, qx: see `predict`. v, s (n x NY): innovations and their variances; a measurement that is
   NaN is skipped (v = 0, s = 1). track (n x NZ), spread (n x NZ): filtered means and variances; either
   may be null. Returns the number of samples with finite state. */
__attribute__((visibility("default")))
int twinproof_innovations(int n, int substeps, double h, double t0, const double *u, const int *ramps,
                          const double *ym,
                          const double *p0, int np, const int *where, const double *phi,
                          const double *q, const double *qx, const double *r, double *z, double *P,
                          double *v, double *s, double *track, double *spread, double *p) {
  double hs = h / substeps;
  double y[NY + 1], C[NY * NX + 1], D[NY * NS + 1], xn[NX + 1], A[NX * NX + 1], B[NX * NS + 1];
  double F[NX * NZ + 1], G[NX * NZ + 1], T[NX * NZ + 1], z0[NZ + 1], gain[NZ], ph[NZ], row[NZ];
  int i, j, k, l, b;
  memcpy(p, p0, np * sizeof(double));
  for (k = 0; k < n; k++) {
    const double *uk = u + (long)k * NU, *un = k + 1 < n ? uk + NU : uk;
    double t = t0 + k * h;
    if (!bounded(NZ, z)) return k;
    observe(NS, t, z, uk, where, p, y, C, D);
    memcpy(z0, z, NZ * sizeof(double));
    for (i = 0; i < NY; i++) { /* one scalar measurement after the other */
      double measured = ym[(long)k * NY + i], e, S = r[i];
      v[(long)k * NY + i] = 0;
      s[(long)k * NY + i] = 1;
      if (measured != measured) continue;
      e = innovation(NZ, i, measured, y, C, D, z, z0, P, row, ph, &S);
      v[(long)k * NY + i] = e;
      s[(long)k * NY + i] = S;
      correct(NZ, e, S, ph, gain, z, P);
    }
    if (track) memcpy(track + (long)k * NZ, z, NZ * sizeof(double));
    if (spread)
      for (l = 0; l < NZ; l++) spread[(long)k * NZ + l] = P[l * NZ + l];
    if (k + 1 == n) break;
    /* dx(k+1)/d(x, d) in F, collected over the integration's steps */
    for (j = 0; j < NS; j++) p[where[j]] = z[NX + j];
    memset(F, 0, sizeof F);
    for (i = 0; i < NX; i++) F[i * NZ + i] = 1;
    for (b = 0; b < substeps; b++) {
      step(b, substeps, t, hs, z, uk, un, ramps, p, xn, A, B);
      chain(NZ, A, B, F, G);
      memcpy(z, xn, NX * sizeof(double));
    }
    predict(NZ, F, phi, q, qx, T, G, z, P);
  }
  return n;
}
