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

/* What differs between draws; decay and steps make the lag's exact solution over half a sample. */
typedef struct {
    vec k_p, a_p, disturbance, decay, steps;
} plant;

/* drawn: k_p, a_p, mu, d. */
INLINE plant prepare(const real *drawn, results out) {
    plant p;
    p.k_p = lanes_of(drawn, 0, out), p.a_p = lanes_of(drawn, 1, out), p.disturbance = lanes_of(drawn, 3, out);
    p.steps = R(0.5 * SAMPLE_TIME) / lanes_of(drawn, 2, out);
    p.decay = p.steps;
    EACH(i) p.decay[i] = R(exp(-(double)p.steps[i]));
    return p;
}

/* mu z1' = u - z1, mu z2' = z1 - z2 over half a sample with u held. */
INLINE void half_sample(const plant *p, vec *z, vec u) {
    vec gap = (z[0] - u) * p->decay;
    z[1] = u + (z[1] - u) * p->decay + p->steps * gap;
    z[0] = u + gap;
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
    const real h = R(SAMPLE_TIME);
    const vec k_p = g->p.k_p, a_p = g->p.a_p, push = g->p.disturbance * on, x = g->x2;
    vec command = control(&LOOP.channel, &g->c, g->x1 - wanted->y, x, wanted, first_sample);
    vec start = k_p * (g->z[1] + push);
    half_sample(&g->p, g->z, command);
    vec middle = k_p * (g->z[1] + push);
    half_sample(&g->p, g->z, command);
    vec end = k_p * (g->z[1] + push);
#if EULER
    (void)middle, (void)end;
    g->x2 += h * (start - a_p * x);
    g->x1 += h * g->x2;
#else
    vec s1 = start - a_p * x, v2 = x + h / 2 * s1; /* slope of x2, and x2, stage by stage */
    vec s2 = middle - a_p * v2, v3 = x + h / 2 * s2;
    vec s3 = middle - a_p * v3, v4 = x + h * s3;
    vec s4 = end - a_p * v4;
    g->x1 += h / 6 * (x + R(2) * (v2 + v3) + v4);
    g->x2 += h / 6 * (s1 + R(2) * (s2 + s3) + s4);
#endif
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
