/* One degree of freedom (5)-(8) of order 2 behind a lag 1/(mu s + 1)^2, with a step of the disturbance. */
#define CHANNELS 1
#ifndef GROUPS
#define GROUPS 4
#endif
#include "dssc.h"

static const struct {
    gains channel;
    sine wanted[CHANNELS];
    double position, velocity, disturbed_from, matched; /* matched: the predictor starts at the first sample's sigma */
} LOOP = NUMBERS;

/* What differs between draws: d, and the exact solution over a sample with command u and disturbance d held.

   Held at u, the lag settles at z = u. Its distance w = z - u from there has no input, and the loop moves as
   x1' = x2, x2' = k_p (w2 + u + d) - a_p x2, w2' = (w1 - w2)/mu, w1' = -w1/mu.
   The entries are those of exp(A h) - 1 by row, at x2, w2, w1 and the input u + d; w1 repeats the first of w2. */
typedef struct {
    vec disturbance, x1[4], x2[4], z2[2];
} plant;

#define TERMS 12 /* of the series: h/mu is 1/4 at most, and (1/4)^13/13! is below rounding */

/* drawn: k_p, a_p, mu, d. */
INLINE plant prepare(const real *drawn, results out) {
    const real h = R(SAMPLE_TIME);
    const vec gain = h * lanes_of(drawn, 0, out), damping = h * lanes_of(drawn, 1, out), rate = h / lanes_of(drawn, 2, out);
    plant p = {0};
    p.disturbance = lanes_of(drawn, 3, out);
    for (int n = TERMS; n > 0; n--) { /* X = A h (1 + X)/n: Horner's rule for the series */
        const real share = R(1.0 / n);
        const vec slow = R(1) + p.x2[0], lag = R(1) + p.z2[0];
        p.x1[0] = share * h * slow;
        for (int i = 1; i < 4; i++) p.x1[i] = share * h * p.x2[i];
        p.x2[0] = -share * damping * slow;
        p.x2[1] = share * (gain * lag - damping * p.x2[1]);
        p.x2[2] = share * (gain * p.z2[1] - damping * p.x2[2]);
        p.x2[3] = share * (gain - damping * p.x2[3]);
        p.z2[1] = share * rate * (lag - p.z2[1]);
        p.z2[0] = -share * rate * lag;
    }
    return p;
}

/* One group of LANES draws. */
typedef struct {
    plant p;
    vec x1, x2, z[2];
    channel c;
    survival s;
} group;

INLINE group start(const real *drawn, const point *wanted, results out) {
    group g = {prepare(drawn, out), fill(R(LOOP.position)), fill(R(LOOP.velocity)), {fill(0), fill(0)}, {0}, {ALL, fill(0)}};
    if (LOOP.matched > 0) g.c.sigma_hat = g.x2 - wanted->y_dot + R(LOOP.channel.l0) * (g.x1 - wanted->y);
    return g;
}

INLINE void sample(group *g, const point *wanted, real on, int first_sample, long first, results out) {
    const plant *p = &g->p;
    const vec x = g->x2;
    vec command = control(&LOOP.channel, &g->c, g->x1 - wanted->y, x, wanted, first_sample);
    vec w1 = g->z[0] - command, w2 = g->z[1] - command, input = command + p->disturbance * on;
    g->x1 += p->x1[0] * x + p->x1[1] * w2 + p->x1[2] * w1 + p->x1[3] * input;
    g->x2 += p->x2[0] * x + p->x2[1] * w2 + p->x2[2] * w1 + p->x2[3] * input;
    g->z[1] += p->z2[0] * w2 + p->z2[1] * w1;
    g->z[0] += p->z2[0] * w1;
    vec sum = g->x1 + g->x2 + g->z[0] + g->z[1] + g->c.u_av + g->c.sigma_hat;
    survive(&g->s, above(fill(LARGEST), size(sum)), ALL, out, first);
}

/* GROUPS LANES draws from start to end. A sample is one chain of operations that wait for each other: several groups
   in turn keep the processor busy. */
INLINE void simulate(const real *drawn, const point *wanted, long samples, long first, results out) {
    group g[GROUPS];
    for (int i = 0; i < GROUPS; i++) g[i] = start(drawn + i * LANES, wanted, out);
    for (long k = 0; k < samples; k++) {
        const real on = begun(LOOP.disturbed_from, k);
        for (int i = 0; i < GROUPS; i++) sample(&g[i], &wanted[k], on, k == 0, first + i * LANES, out);
        if (k % 64 == 0) {
            mask alive = g[0].s.alive;
            for (int i = 1; i < GROUPS; i++) alive |= g[i].s.alive;
            if (!any(alive)) break;
        }
    }
    for (int i = 0; i < GROUPS; i++) report(&g[i].s, &g[i].c, samples, out, first + i * LANES);
}
