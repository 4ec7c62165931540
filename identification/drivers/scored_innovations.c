/* Extended Kalman filter over states and slowly varying disturbances that goes on where it stopped, with
   what a change of each parameter would do to its innovations: the score of the likelihood and its
   information, with the gains as they are. Before this stand the generated functions of the model and its
   sizes: NX states, NU inputs, NS sensitive parameters, first the `nd` disturbances, then those that are
   followed; NY outputs, WORK doubles of scratch. */
#include <math.h>
#include <string.h>
enum { NZ = NX + NS };

/* m = NX + nd, np = NS - nd. z (m), P (m x m, symmetric), Z (m x np, dz/dtheta) hold the prediction for the
   first sample and leave as that for the sample after the last. u (n+1 x NU): inputs, the last row those of
   that sample. ym (n x NY): measured, NaN where missing. r (NY): variances of the sensors; where[NS]: index of
   each sensitive parameter; phi, q (nd): decay of a disturbance over a sample and the variance that a sample
   adds; qx (NX): variance that a sample adds to a state. v, s (n x NY): innovations and their variances.
   score (np), information (np x np), each summed over the samples. x (n x NX): filtered states. Returns the
   number of samples with finite state. */
__attribute__((visibility("default")))
int twinproof_scored(int n, int nd, int substeps, double h, double t0, const double *u, const int *ramps,
                     const double *ym, const double *p0, int all, const int *where, const double *phi,
                     const double *q, const double *qx, const double *r, double *z, double *P, double *Z,
                     double *v, double *s, double *score, double *information, double *x, double *p) {
  const int m = NX + nd, np = NS - nd;
  double hs = h / substeps, w[WORK];
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
    for (i = 0; i < m; i++)
      if (!(z[i] > -1e12 && z[i] < 1e12)) return k;
    for (j = 0; j < nd; j++) p[where[j]] = z[NX + j];
    {
      const double *arg[4] = {&t, z, uk, p};
      double *res[3] = {y, C, D};
      twinproof_output_sensitive(arg, res, 0, w, 0);
    }
    memcpy(z0, z, m * sizeof(double));
    for (i = 0; i < NY; i++) { /* one scalar measurement after the other */
      double measured = ym[(long)k * NY + i], e, S = r[i];
      v[(long)k * NY + i] = 0;
      s[(long)k * NY + i] = 1;
      if (measured != measured) continue;
      e = measured - y[i];
      for (l = 0; l < NX; l++) row[l] = C[l * NY + i];
      for (l = 0; l < nd; l++) row[NX + l] = D[l * NY + i];
      for (l = 0; l < m; l++) e -= row[l] * (z[l] - z0[l]);
      for (l = 0; l < m; l++) {
        double a = 0;
        for (j = 0; j < m; j++) a += P[l * m + j] * row[j];
        ph[l] = a;
      }
      for (l = 0; l < m; l++) S += row[l] * ph[l];
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
      for (l = 0; l < m; l++) gain[l] = ph[l] / S;
      for (l = 0; l < m; l++) {
        z[l] += gain[l] * e;
        for (j = 0; j < np; j++) Z[l * np + j] -= gain[l] * psi[j];
      }
      for (l = 0; l < m; l++) /* symmetric by construction */
        for (j = 0; j <= l; j++) P[l * m + j] = P[j * m + l] = P[l * m + j] - gain[l] * ph[j];
      for (l = 0; l < m; l++)
        if (P[l * m + l] < 1e-300) P[l * m + l] = 1e-300;
    }
    memcpy(x + (long)k * NX, z, NX * sizeof(double));
    /* dx(k+1)/d(x, d) in F, collected over the integration's steps; Z's states along with it */
    for (j = 0; j < nd; j++) p[where[j]] = z[NX + j];
    memset(F, 0, sizeof F);
    for (i = 0; i < NX; i++) F[i * m + i] = 1;
    for (b = 0; b < substeps; b++) {
      double from = (double)b / substeps, to = (double)(b + 1) / substeps, ts = t + b * hs;
      double ua[NU + 1], ub[NU + 1];
      for (i = 0; i < NU; i++) {
        double ramp = ramps[i] ? un[i] - uk[i] : 0;
        ua[i] = uk[i] + from * ramp;
        ub[i] = uk[i] + to * ramp;
      }
      {
        const double *arg[6] = {&ts, z, ua, ub, p, &hs};
        double *res[3] = {xn, A, B};
        twinproof_step_sensitive(arg, res, 0, w, 0);
      }
      for (i = 0; i < NX; i++) {
        for (j = 0; j < m; j++) {
          double a = j < NX ? 0 : B[(j - NX) * NX + i];
          for (l = 0; l < NX; l++) a += A[l * NX + i] * F[l * m + j];
          G[i * m + j] = a;
        }
        for (j = 0; j < np; j++) {
          double a = B[(nd + j) * NX + i];
          for (l = 0; l < NX; l++) a += A[l * NX + i] * Z[l * np + j];
          for (l = 0; l < nd; l++) a += B[l * NX + i] * Z[(NX + l) * np + j];
          Y[i * np + j] = a;
        }
      }
      memcpy(F, G, NX * m * sizeof(double));
      memcpy(Z, Y, NX * np * sizeof(double));
      memcpy(z, xn, NX * sizeof(double));
    }
    /* P <- [F; 0 phi] P [F; 0 phi]' + Q */
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
      for (j = 0; j < np; j++) Z[(NX + i) * np + j] *= phi[i];
    }
  }
  for (j = 0; j < np; j++)
    for (l = 0; l < j; l++) information[l * np + j] = information[j * np + l];
  return n;
}
