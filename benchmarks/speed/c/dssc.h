/* What both loops share: a DSSC channel with nominal control, the reference, and the three metrics. */
#ifndef DSSC_H
#define DSSC_H

#include <string.h>

#include "lanes.h"

typedef struct {
    double l0, rho, kappa_o, kappa_m, delta_o, delta_m, tau_av, a_n, k_n;
} gains;

typedef struct {
    double amplitude, rate, phase, offset;
} sine;

typedef struct {
    real y, y_dot, y_ddot;
} point;

typedef struct {
    vec u_av, sigma_hat;             /* controller */
    vec u;                           /* of the last sample */
    vec squares, largest, variation; /* sum of e^2, max |e|, sum of |u - u_previous| */
} channel;

static point sine_at(const sine *s, double t) {
    double angle = s->rate * t + s->phase, swing = s->amplitude * sin(angle), slope = s->amplitude * cos(angle);
    return (point){R(s->offset + swing), R(s->rate * slope), R(-s->rate * s->rate * swing)};
}

/* How much of the sample that begins at k SAMPLE_TIME comes after a time. */
INLINE real begun(double from, long k) {
    real share = (R(k) * R(SAMPLE_TIME) + R(SAMPLE_TIME) - R(from)) * R(1 / SAMPLE_TIME);
    return share < 0 ? 0 : share > 1 ? 1 : share;
}

/* u_n of (37) and the implicit form of (15)-(18) with the square-root functions, from e and y' at a sample; metrics.
   Returns u + u_n. One division serves 1/tau_m, tau_m/(tau_m + dt) and 1/c. */
INLINE vec control(const gains *g, channel *c, vec e, vec y_dot, const point *wanted, int first) {
    const double dt = SAMPLE_TIME, scale = dt * g->kappa_o * g->tau_av / (g->tau_av + dt);
    vec sigma = y_dot - wanted->y_dot + R(g->l0) * e, r = root(size(sigma));
    vec gain = R(scale) * r + R(scale * g->delta_o);
    vec tau_m = R(g->kappa_m) * r + R(g->kappa_m * g->delta_m), longer = tau_m + R(dt);
    vec product = gain * tau_m, inverse = R(1) / (product * longer), over = inverse * longer;
    vec pole = over * gain, decay = inverse * product * tau_m;

    real forward = (R(g->a_n) * wanted->y_dot + wanted->y_ddot) * R(1 / g->k_n);
    vec feedback = R((g->a_n - g->l0) * g->l0 / g->k_n) * e + (R((g->l0 - g->a_n) / g->k_n) + R(1 / g->k_n) * pole) * sigma;

    vec change = clip((longer * sigma - tau_m * c->sigma_hat) * over, R(-g->rho) - c->u_av, R(g->rho) - c->u_av);
    c->u_av += R(dt / (g->tau_av + dt)) * change;
    c->sigma_hat = decay * (c->sigma_hat + gain * change);

    vec u = -c->u_av;
    c->squares += e * e;
    c->largest = most(c->largest, size(e));
    if (!first) c->variation += size(u - c->u);
    c->u = u;
    return u + (forward - feedback);
}

/* Where results go: metrics[(metric CHANNELS + channel) draws + draw], metrics error_rms, error_max, command_tv. */
typedef struct {
    real *metrics;
    int *outcome; /* 0 finished, 1 not finite, 2 singular attitude */
    int *ended;   /* samples until then */
    long draws;
} results;

/* Draws that have not ended yet; each group of LANES keeps its own. */
typedef struct {
    mask alive;
    vec samples;
} survival;

/* Take note of the draws that a sample ended. */
INLINE void survive(survival *s, mask finite, mask intact, results out, long first) {
    mask ended = s->alive & ~(finite & intact);
    if (any(ended))
        EACH(i) if (holds(ended, i)) out.outcome[first + i] = holds(finite, i) ? 2 : 1;
    s->alive &= finite & intact;
    s->samples += choose(s->alive, fill(1), fill(0));
}

INLINE void report(const survival *s, const channel *c, long samples, results out, long first) {
    for (int j = 0; j < CHANNELS; j++) {
        const vec found[3] = {root(c[j].squares / R(samples)), c[j].largest, c[j].variation};
        for (int m = 0; m < 3; m++)
            EACH(i) out.metrics[(m * CHANNELS + j) * out.draws + first + i] = holds(s->alive, i) ? found[m][i] : R(NAN);
    }
    EACH(i) out.ended[first + i] = (int)s->samples[i];
}

/* One drawn number of LANES draws. */
INLINE vec lanes_of(const real *drawn, int row, results out) {
    vec x;
    memcpy(&x, drawn + row * out.draws, sizeof x);
    return x;
}
#endif
