/* Windowed simulation with sensitivities. Before this stand the generated functions of the model and
   its sizes: NX states, NU inputs (the last ND of them delayed signals), NS sensitive parameters,
   NY outputs, WORK doubles of scratch. */
#include <string.h>
enum { NC = NX + NS };
/* One window of n samples: y and dy/d(x0, s) at every sample. sensitive = 0: no sensitivities.
   An input is held over a sample interval where ramps[] is 0; the others and the delayed signals
   (the last ND columns) run linearly between samples. Returns the number of samples with finite state. */
__attribute__((visibility("default")))
int twinproof_shoot(int n, int substeps, double h, double t0, const double *x0, const double *u,
                    const int *ramps,
                    const double *p, int sensitive, double *y, double *dy) {
  double x[NX + 1], xn[NX + 1], a[NX * NX + 1], b[NX * NS + 1], c[NY * NX + 1], d[NY * NS + 1];
  double s[NX * NC + 1], sn[NX * NC + 1], us[NU + 1], t, hs = h / substeps;
  double w[WORK];
  int i, j, k, l, m;
  memcpy(x, x0, NX * sizeof(double));
  memset(s, 0, sizeof s);
  for (i = 0; i < NX; i++) s[i * NX + i] = 1;
  if (FOLLOWING) { /* the filters of sensors begin where their signals lead them */
    const double *arg[4] = {&t0, x, u, p};
    double *res[3] = {xn, s, s + NX * NX};
    twinproof_start(arg, res, 0, w, 0);
    memcpy(x, xn, NX * sizeof(double));
  }
  for (k = 0; k < n; k++) {
    const double *uk = u + (long)k * NU, *un = k + 1 < n ? uk + NU : uk;
    t = t0 + k * h;
    for (i = 0; i < NX; i++)
      if (!(x[i] > -1e12 && x[i] < 1e12)) return k;
    {
      const double *arg[4] = {&t, x, uk, p};
      double *res[3] = {y + (long)k * NY, c, d};
      if (sensitive) twinproof_output_sensitive(arg, res, 0, w, 0);
      else twinproof_output(arg, res, 0, w, 0);
    }
    if (sensitive) {
      double *o = dy + (long)k * NC * NY; /* column-major: o[column * NY + output] */
      for (j = 0; j < NC; j++)
        for (i = 0; i < NY; i++) {
          double v = j < NX ? 0 : d[(j - NX) * NY + i];
          for (l = 0; l < NX; l++) v += c[l * NY + i] * s[j * NX + l];
          o[j * NY + i] = v;
        }
    }
    if (k + 1 == n) break;
    for (m = 0; m < substeps; m++) {
      double from = (double)m / substeps, to = (double)(m + 1) / substeps, uf[NU + 1];
      for (i = 0; i < NU; i++) {
        double ramp = i < NU - ND && !ramps[i] ? 0 : un[i] - uk[i];
        us[i] = uk[i] + from * ramp;
        uf[i] = uk[i] + to * ramp;
      }
      {
        double ts = t + m * hs;
        const double *arg[6] = {&ts, x, us, uf, p, &hs};
        double *res[3] = {xn, a, b};
        if (sensitive) twinproof_step_sensitive(arg, res, 0, w, 0);
        else twinproof_step(arg, res, 0, w, 0);
      }
      if (sensitive) {
        for (j = 0; j < NC; j++)
          for (i = 0; i < NX; i++) {
            double v = j < NX ? 0 : b[(j - NX) * NX + i];
            for (l = 0; l < NX; l++) v += a[l * NX + i] * s[j * NX + l];
            sn[j * NX + i] = v;
          }
        memcpy(s, sn, sizeof s);
      }
      memcpy(x, xn, NX * sizeof(double));
    }
  }
  return n;
}
