/* The fused loop of a splitting method for one Hertz chain between rigid walls, and for a batch of chains.

   One pass kicks and drifts, one evaluates every contact force once. Tiny forces ahead of a wave are flushed to zero
   while the loop runs: processors take a hundred cycles over a number below 1e-308. */

#include <math.h>
#if defined(__x86_64__)
#include <immintrin.h>
#define FLUSH unsigned kept = _mm_getcsr(); _mm_setcsr(kept | 0x8040)
#define RESTORE _mm_setcsr(kept)
#else
#define FLUSH
#define RESTORE
#endif

static inline double contact(double s, double A, double F0) {
    s = s > 0 ? s : 0;
    return A * (s * sqrt(s)) - F0;
}

static inline void forces(const double *restrict u, double *restrict f, long N, double A, double d0, double F0) {
    f[0] = contact(d0 - u[0], A, F0);
    for (long i = 1; i < N; i++) f[i] = contact(d0 + u[i - 1] - u[i], A, F0);
    f[N] = contact(d0 + u[N - 1], A, F0);
}

void chain(double *restrict u, double *restrict v, double *restrict f, long N, long steps, double h, double A,
           double d0, double F0, double w, const double *a, const double *b, long stages) {
    FLUSH;
    forces(u, f, N, A, d0, F0);
    for (long k = 0; k < steps; k++) {
        for (long j = 0; j < stages; j++) {
            const double ah = a[j] * h, bh = b[j] * h * w;
            for (long i = 0; i < N; i++) {
                const double x = v[i] + bh * (f[i] - f[i + 1]);
                v[i] = x;
                u[i] += ah * x;
            }
            forces(u, f, N, A, d0, F0);
        }
        const double bh = b[stages] * h * w;
        for (long i = 0; i < N; i++) v[i] += bh * (f[i] - f[i + 1]);
    }
    RESTORE;
}

/* u, v, w: (chains, N) */
void batch(double *restrict us, double *restrict vs, double *restrict f, long chains, long N, long steps, double h,
           double A, double d0, double F0, const double *restrict ws, const double *a, const double *b, long stages) {
    FLUSH;
    for (long c = 0; c < chains; c++) {
        double *restrict u = us + c * N, *restrict v = vs + c * N;
        const double *restrict w = ws + c * N;
        forces(u, f, N, A, d0, F0);
        for (long k = 0; k < steps; k++) {
            for (long j = 0; j < stages; j++) {
                const double ah = a[j] * h, bh = b[j] * h;
                for (long i = 0; i < N; i++) {
                    const double x = v[i] + bh * w[i] * (f[i] - f[i + 1]);
                    v[i] = x;
                    u[i] += ah * x;
                }
                forces(u, f, N, A, d0, F0);
            }
            const double bh = b[stages] * h;
            for (long i = 0; i < N; i++) v[i] += bh * w[i] * (f[i] - f[i + 1]);
        }
    }
    RESTORE;
}
