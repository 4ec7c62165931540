/* Extended Kalman filter over states and slowly varying disturbances that goes on where it stopped, with
   what a change of each parameter would do to its innovations: the score of the likelihood and its
   information, with the gains as they are. Of the NS sensitive parameters the first `nd` are
   disturbances, the rest are followed. */
#include "kalman.h"

/* m = NX + nd, np = NS - nd. z (m), P (m x m, symmetric), Z (m x np, dz/dtheta) hold the prediction for the
   first sample and leave as that for the sample after the last. u (n+1 x NU): inputs, the last row those of
   that sample. ym (n x NY): measured, NaN where missing. r (NY): variances of the sensors; where[NS]: index of
   each sensitive parameter; phi, q, qx: see `predict`. v, s (n x NY): innovations and their variances.
   score (np), information (np x np), each summed over the samples. x (n x NX): filtered states. Returns the
   number of samples with finite state. */
__attribute__((visibility("default")))
int twinproof_scored(int n, int nd, int substeps, double h, double t0, const double *u, const int *ramps,
                     const double *ym, const double *p0, int all, const int *where, const double *phi,
                     const double *q, const double *qx, const double *r, double *z, double *P, double *Z,
                     double *v, double *s, double *score, double *information, double *x, double *p) {
  const int m = NX + nd, np = NS - nd;
  double hs = h / substeps;
  double y[NY + 1], C[NY * NX + 1], D[NY * NS + 1], xn[NX + 1], A[NX * NX + 1], B[NX * NS + 1];
  double F[NX * NZ + 1], G[NX * NZ + 1], T[NX * NZ + 1], Y[NX * NS + 1], row[NZ], ph[NZ], gain[NZ], psi[NS + 1];
  double z0[NZ + 1];
  int i, j, k, l, b;
  memcpy(p, p0, all * sizeof(double));
  memset(score, 0, np * sizeof(double));
  memset(information, 0, np * np * sizeof(double));
  for (k = 0; k < n; k++) {
    const double *uk = u + (long)k * NU, *un = uk + NU;
    double t = t0 + k * h;
    if (!bounded(m, z)) return k;
    observe(nd, t, z, uk, where, p, y, C, D);
    memcpy(z0, z, m * sizeof(double));
    for (i = 0; i < NY; i++) { /* one scalar measurement after the other */
      double measured = ym[(long)k * NY + i], e, S = r[i];
      v[(long)k * NY + i] = 0;
      s[(long)k * NY + i] = 1;
      if (measured != measured) continue;
      e = innovation(m, i, measured, y, C, D, z, z0, P, row, ph, &S);
      v[(long)k * NY + i] = e;
      s[(long)k * NY + i] = S;
      for (j = 0; j < np; j++) { /* what the prediction of this measurement does with theta */
        double a = D[(nd + j) * NY + i];
        for (l = 0; l < m; l++) a += row[l] * Z[l * np + j];
        psi[j] = a;
      }
      for (j = 0; j < np; j++) {
        score[j] += psi[j] * e / S;
        for (l = 0; l <= j; l++) information[j * np + l] += psi[j] * psi[l] / S;
      }
      correct(m, e, S, ph, gain, z, P);
      for (l = 0; l < m; l++)
        for (j = 0; j < np; j++) Z[l * np + j] -= gain[l] * psi[j];
    }
    memcpy(x + (long)k * NX, z, NX * sizeof(double));
    /* dx(k+1)/d(x, d) in F, collected over the integration's steps; Z's states along with it */
    for (j = 0; j < nd; j++) p[where[j]] = z[NX + j];
    memset(F, 0, sizeof F);
    for (i = 0; i < NX; i++) F[i * m + i] = 1;
    for (b = 0; b < substeps; b++) {
      step(b, substeps, t, hs, z, uk, un, ramps, p, xn, A, B);
      chain(m, A, B, F, G);
      for (i = 0; i < NX; i++)
        for (j = 0; j < np; j++) {
          double a = B[(nd + j) * NX + i];
          for (l = 0; l < NX; l++) a += A[l * NX + i] * Z[l * np + j];
          for (l = 0; l < nd; l++) a += B[l * NX + i] * Z[(NX + l) * np + j];
          Y[i * np + j] = a;
        }
      memcpy(Z, Y, NX * np * sizeof(double));
      memcpy(z, xn, NX * sizeof(double));
    }
    predict(m, F, phi, q, qx, T, G, z, P);
    for (i = 0; i < nd; i++)
      for (j = 0; j < np; j++) Z[(NX + i) * np + j] *= phi[i];
  }
  for (j = 0; j < np; j++)
    for (l = 0; l < j; l++) information[l * np + j] = information[j * np + l];
  return n;
}
