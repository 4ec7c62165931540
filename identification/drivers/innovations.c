/* Extended Kalman filter over states and slowly varying disturbances, with the log-likelihood's parts.
   Before this stand the generated functions of the model and its sizes: NX states, NU inputs (the last
   ND of them delayed signals), NS disturbances (parameters of the model that vary as first-order
   Gauss-Markov processes), NY outputs, WORK doubles of scratch. */
#include <math.h>
#include <string.h>
enum { NZ = NX + NS };

/* z (NZ) and P (NZ x NZ, symmetric) hold the prior at the first sample and leave as the last
   prediction. r (NY): sensors' variances; where[NS]: index of each disturbance among the parameters;
   phi, q (NS): its decay over a sample and the variance that a sample adds; qx (NX): variance that a
   sample adds to each state. v, s (n x NY): innovations and their variances; a measurement that is
   NaN is skipped (v = 0, s = 1). track (n x NZ), spread (n x NZ): filtered means and variances; either
   may be null. Returns the number of samples with finite state. */
__attribute__((visibility("default")))
int twinproof_innovations(int n, int substeps, double h, double t0, const double *u, const int *ramps,
                          const double *ym,
                          const double *p0, int np, const int *where, const double *phi,
                          const double *q, const double *qx, const double *r, double *z, double *P,
                          double *v, double *s, double *track, double *spread, double *p) {
  double hs = h / substeps, w[WORK];
  double y[NY + 1], C[NY * NX + 1], D[NY * NS + 1], xn[NX + 1], A[NX * NX + 1], B[NX * NS + 1];
  double F[NX * NZ + 1], G[NX * NZ + 1], T[NX * NZ + 1], z0[NZ + 1], gain[NZ], ph[NZ], row[NZ];
  int i, j, k, l, m;
  memcpy(p, p0, np * sizeof(double));
  for (k = 0; k < n; k++) {
    const double *uk = u + (long)k * NU, *un = k + 1 < n ? uk + NU : uk;
    double t = t0 + k * h;
    for (i = 0; i < NZ; i++)
      if (!(z[i] > -1e12 && z[i] < 1e12)) return k;
    for (j = 0; j < NS; j++) p[where[j]] = z[NX + j];
    {
      const double *arg[4] = {&t, z, uk, p};
      double *res[3] = {y, C, D};
      twinproof_output_sensitive(arg, res, 0, w, 0);
    }
    memcpy(z0, z, NZ * sizeof(double));
    for (i = 0; i < NY; i++) { /* one scalar measurement after the other */
      double measured = ym[(long)k * NY + i], e, S = r[i];
      v[(long)k * NY + i] = 0;
      s[(long)k * NY + i] = 1;
      if (measured != measured) continue;
      e = measured - y[i];
      for (l = 0; l < NX; l++) row[l] = C[l * NY + i];
      for (l = 0; l < NS; l++) row[NX + l] = D[l * NY + i];
      for (l = 0; l < NZ; l++) e -= row[l] * (z[l] - z0[l]);
      for (l = 0; l < NZ; l++) {
        double a = 0;
        for (j = 0; j < NZ; j++) a += P[l * NZ + j] * row[j];
        ph[l] = a;
      }
      for (l = 0; l < NZ; l++) S += row[l] * ph[l];
      v[(long)k * NY + i] = e;
      s[(long)k * NY + i] = S;
      for (l = 0; l < NZ; l++) gain[l] = ph[l] / S;
      for (l = 0; l < NZ; l++) z[l] += gain[l] * e;
      for (l = 0; l < NZ; l++) /* symmetric by construction */
        for (j = 0; j <= l; j++) P[l * NZ + j] = P[j * NZ + l] = P[l * NZ + j] - gain[l] * ph[j];
      for (l = 0; l < NZ; l++)
        if (P[l * NZ + l] < 1e-300) P[l * NZ + l] = 1e-300;
    }
    if (track) memcpy(track + (long)k * NZ, z, NZ * sizeof(double));
    if (spread)
      for (l = 0; l < NZ; l++) spread[(long)k * NZ + l] = P[l * NZ + l];
    if (k + 1 == n) break;
    /* dx(k+1)/d(x, d), collected over the integration's steps */
    for (j = 0; j < NS; j++) p[where[j]] = z[NX + j];
    memset(F, 0, sizeof F);
    for (i = 0; i < NX; i++) F[i * NZ + i] = 1;
    for (m = 0; m < substeps; m++) {
      double from = (double)m / substeps, to = (double)(m + 1) / substeps, ts = t + m * hs;
      double ua[NU + 1], ub[NU + 1];
      for (i = 0; i < NU; i++) {
        double ramp = i < NU - ND && !ramps[i] ? 0 : un[i] - uk[i];
        ua[i] = uk[i] + from * ramp;
        ub[i] = uk[i] + to * ramp;
      }
      {
        const double *arg[6] = {&ts, z, ua, ub, p, &hs};
        double *res[3] = {xn, A, B};
        twinproof_step_sensitive(arg, res, 0, w, 0);
      }
      for (i = 0; i < NX; i++)
        for (j = 0; j < NZ; j++) {
          double a = j < NX ? 0 : B[(j - NX) * NX + i];
          for (l = 0; l < NX; l++) a += A[l * NX + i] * F[l * NZ + j];
          G[i * NZ + j] = a;
        }
      memcpy(F, G, sizeof F);
      memcpy(z, xn, NX * sizeof(double));
    }
    /* P <- [F; 0 phi] P [F; 0 phi]' + Q */
    for (i = 0; i < NX; i++)
      for (j = 0; j < NZ; j++) {
        double a = 0;
        for (l = 0; l < NZ; l++) a += F[i * NZ + l] * P[l * NZ + j];
        T[i * NZ + j] = a;
      }
    for (i = 0; i < NX; i++)
      for (j = 0; j <= i; j++) {
        double a = 0;
        for (l = 0; l < NZ; l++) a += T[i * NZ + l] * F[j * NZ + l];
        G[i * NZ + j] = a;
      }
    for (i = 0; i < NX; i++) {
      for (j = 0; j <= i; j++) P[i * NZ + j] = P[j * NZ + i] = G[i * NZ + j];
      P[i * NZ + i] += qx[i];
      for (j = 0; j < NS; j++) P[i * NZ + NX + j] = P[(NX + j) * NZ + i] = T[i * NZ + NX + j] * phi[j];
    }
    for (i = 0; i < NS; i++) {
      for (j = 0; j < NS; j++) P[(NX + i) * NZ + NX + j] *= phi[i] * phi[j];
      P[(NX + i) * NZ + NX + i] += q[i];
      z[NX + i] *= phi[i];
    }
  }
  return n;
}
