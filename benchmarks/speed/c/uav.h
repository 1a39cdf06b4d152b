/* The full UAV (1) with inner loops, allocation with limits, rotors and drag; equations as in dssc_jax/uav. */
#define CHANNELS 4
#define GROUPS 1
#define ROTORS 4
#include "dssc.h"

#define GRAVITY 9.81
#define LEAST_LIFT (0.1 * GRAVITY)
#define LEAST_UPRIGHT 0.08715574274765817356 /* cos 85 deg */

static const struct {
    gains channel[CHANNELS];
    sine wanted[CHANNELS];
    double wind[3], wind_from, position[3], velocity[3], yaw;
    double kp_velocity, kd_velocity, kp_attitude, kd_attitude, kp_yaw, kd_yaw;
    double believed_mass, believed_inertia[3], believed_thrust_coefficient;
    double allocation[ROTORS][4]; /* from thrust and moment to each rotor */
    double rotor_x[ROTORS], rotor_y[ROTORS], spin[ROTORS];
    double torque_coefficient, rotor_inertia_xy, rotor_inertia_z, structure_drag[3], propeller_drag;
} LOOP = NUMBERS;

/* What differs between draws: 1/M, 1/J, (J_k - J_j)/J_i for i, j, k in cyclic order, k_T over the believed one, f_max. */
typedef struct {
    vec mass_inverse, inertia_inverse[3], precession[3], thrust_ratio, thrust_limit;
} vehicle;

typedef struct {
    vec position[3], velocity[3], attitude[4], rate[3], path[3] /* int (u - v) */, turned /* int (u_psi - psi') */;
} body;
#define BODY_VECS (sizeof(body) / sizeof(vec))

/* Rotation matrix, trigonometry and Euler rates of an attitude, once for all that need them. */
typedef struct {
    vec r[3][3], cphi, sphi, ctheta, stheta, cpsi, spsi, dphi, dtheta, dpsi;
} frame;

/* drawn: M, I_bx, I_by, I_bz, k_T. */
INLINE vehicle prepare(const real *drawn, results out) {
    const double hub[3] = {LOOP.rotor_inertia_xy, LOOP.rotor_inertia_xy, LOOP.rotor_inertia_z};
    vehicle v;
    vec inertia[3], mass = lanes_of(drawn, 0, out);
    v.mass_inverse = R(1) / mass;
    v.thrust_limit = R(2 * GRAVITY / ROTORS) * mass;
    v.thrust_ratio = lanes_of(drawn, 4, out) * R(1 / LOOP.believed_thrust_coefficient);
    for (int i = 0; i < 3; i++) inertia[i] = lanes_of(drawn, 1 + i, out) + R(ROTORS * hub[i]);
    for (int i = 0; i < 3; i++) {
        v.inertia_inverse[i] = R(1) / inertia[i];
        v.precession[i] = (inertia[(i + 2) % 3] - inertia[(i + 1) % 3]) * v.inertia_inverse[i];
    }
    return v;
}

INLINE frame look(const body *b) {
    frame f;
    vec w = b->attitude[0], x = b->attitude[1], y = b->attitude[2], z = b->attitude[3];
    vec x2 = x + x, y2 = y + y, z2 = z + z;
    vec xx = x * x2, yy = y * y2, zz = z * z2, xy = x * y2, xz = x * z2, yz = y * z2, wx = w * x2, wy = w * y2, wz = w * z2;
    f.r[0][0] = R(1) - (yy + zz), f.r[0][1] = xy - wz, f.r[0][2] = xz + wy;
    f.r[1][0] = xy + wz, f.r[1][1] = R(1) - (xx + zz), f.r[1][2] = yz - wx;
    f.r[2][0] = xz - wy, f.r[2][1] = yz + wx, f.r[2][2] = R(1) - (xx + yy);
    f.stheta = -f.r[2][0];
    f.ctheta = root(most(f.r[2][1] * f.r[2][1] + f.r[2][2] * f.r[2][2], fill(R(1e-12))));
    vec inverse = R(1) / f.ctheta;
    f.cphi = f.r[2][2] * inverse, f.sphi = f.r[2][1] * inverse;
    f.cpsi = f.r[0][0] * inverse, f.spsi = f.r[1][0] * inverse;
    f.dpsi = (f.sphi * b->rate[1] + f.cphi * b->rate[2]) * inverse;
    f.dphi = b->rate[0] + f.stheta * f.dpsi;
    f.dtheta = f.cphi * b->rate[1] - f.sphi * b->rate[2];
    return f;
}

/* p', and the rates of attitude and integrals. */
INLINE void kinematics(const body *b, const frame *f, const vec *command, body *slope) {
    const vec *q = b->attitude;
    vec w[3];
    for (int i = 0; i < 3; i++) {
        w[i] = R(0.5) * b->rate[i];
        slope->position[i] = b->velocity[i];
        slope->path[i] = command[i] - b->velocity[i];
    }
    slope->turned = command[3] - f->dpsi;
    slope->attitude[0] = -(q[1] * w[0] + q[2] * w[1] + q[3] * w[2]);
    slope->attitude[1] = q[0] * w[0] + q[2] * w[2] - q[3] * w[1];
    slope->attitude[2] = q[0] * w[1] + q[3] * w[0] - q[1] * w[2];
    slope->attitude[3] = q[0] * w[2] + q[1] * w[1] - q[2] * w[0];
}

/* Inner loops: the net thrust and the moment that they want. */
INLINE void demand(const body *b, const frame *f, const vec *command, vec *thrust, vec *moment) {
    const double *j = LOOP.believed_inertia;
    vec a[3];
    for (int i = 0; i < 3; i++)
        a[i] = R(LOOP.kd_velocity) * (command[i] - b->velocity[i]) + R(LOOP.kp_velocity) * b->path[i];
    a[2] = most(a[2] + R(GRAVITY), fill(R(LEAST_LIFT)));
    *thrust = R(LOOP.believed_mass) * a[2] / f->r[2][2];

    vec forward = a[0] * f->cpsi + a[1] * f->spsi, left = a[0] * f->spsi - a[1] * f->cpsi;
    vec phi_d = atan_ratio(left, root(forward * forward + a[2] * a[2])), theta_d = atan_ratio(forward, a[2]);
    vec phi = atan_ratio(f->r[2][1], f->r[2][2]), theta = atan_ratio(f->stheta, f->ctheta);
    vec ddphi = R(LOOP.kp_attitude) * (phi_d - phi) - R(LOOP.kd_attitude) * f->dphi;
    vec ddtheta = R(LOOP.kp_attitude) * (theta_d - theta) - R(LOOP.kd_attitude) * f->dtheta;
    vec ddpsi = R(LOOP.kd_yaw) * (command[3] - f->dpsi) + R(LOOP.kp_yaw) * b->turned;

    /* J (W euler'' + W' euler') + Omega x J Omega */
    const vec *w = b->rate;
    vec turning = f->ctheta * f->dpsi, pitching = ddtheta + f->dphi * turning;
    vec yawing = f->ctheta * ddpsi - f->dtheta * (f->dphi + f->stheta * f->dpsi);
    vec rolling = ddphi - f->stheta * ddpsi - f->dtheta * turning;
    moment[0] = R(j[0]) * rolling + R(j[2] - j[1]) * (w[1] * w[2]);
    moment[1] = R(j[1]) * (f->cphi * pitching + f->sphi * yawing) + R(j[0] - j[2]) * (w[2] * w[0]);
    moment[2] = R(j[2]) * (f->cphi * yawing - f->sphi * pitching) + R(j[1] - j[0]) * (w[0] * w[1]);
}

/* v' and Omega'. */
INLINE void dynamics(const vehicle *v, const body *b, const frame *f, const vec *command, const real *wind, body *slope) {
    vec wanted, moment[3], total = fill(0), mx = total, my = total, mz = total;
    vec s = total, sx = total, sy = total, sxx = total, sxy = total, syy = total, whirl = total;
    demand(b, f, command, &wanted, moment);
    /* speed_i = (f_i/k_T)^(1/2); s.. are sums over rotors of K_Fdi speed_i times 1, x, y, x^2, x y, y^2 */
    const double pace = 1 / sqrt(LOOP.believed_thrust_coefficient), k = LOOP.propeller_drag * pace;
    for (int i = 0; i < ROTORS; i++) {
        const double *row = LOOP.allocation[i], x = LOOP.rotor_x[i], y = LOOP.rotor_y[i], spin = LOOP.spin[i];
        vec thrust = R(row[0]) * wanted + R(row[1]) * moment[0] + R(row[2]) * moment[1] + R(row[3]) * moment[2];
        thrust = clip(thrust, fill(0), v->thrust_limit);
        vec speed = root(thrust);
        total += thrust, mx += R(y) * thrust, my -= R(x) * thrust, mz += R(spin) * thrust;
        s += speed, whirl += R(spin) * speed, sx += R(k * x) * speed, sy += R(k * y) * speed;
        sxx += R(k * x * x) * speed, sxy += R(k * x * y) * speed, syy += R(k * y * y) * speed;
    }
    s *= R(k);

    const vec *w = b->rate;
    vec air[3], flow[3], force[3];
    for (int i = 0; i < 3; i++) air[i] = b->velocity[i] - wind[i];
    vec speed = root(air[0] * air[0] + air[1] * air[1] + air[2] * air[2]);
    for (int i = 0; i < 3; i++) {
        flow[i] = f->r[0][i] * air[0] + f->r[1][i] * air[1] + f->r[2][i] * air[2];
        force[i] = -flow[i] * (R(LOOP.structure_drag[i]) * speed + s);
    }
    force[0] += w[2] * sy;
    force[1] -= w[2] * sx;
    force[2] += total * v->thrust_ratio + w[1] * sx - w[0] * sy;
    for (int i = 0; i < 3; i++) {
        vec along = f->r[i][0] * force[0] + f->r[i][1] * force[1] + f->r[i][2] * force[2];
        slope->velocity[i] = along * v->mass_inverse - R(i == 2 ? GRAVITY : 0);
    }

    vec h = R(-LOOP.rotor_inertia_z * pace) * whirl; /* rotors turn against s_i */
    vec tx = mx * v->thrust_ratio - sy * flow[2] - syy * w[0] + (sxy - h) * w[1];
    vec ty = my * v->thrust_ratio + sx * flow[2] - sxx * w[1] + (sxy + h) * w[0];
    vec tz = mz * (R(LOOP.torque_coefficient) * v->thrust_ratio) - sx * flow[1] + sy * flow[0] - (sxx + syy) * w[2];
    slope->rate[0] = tx * v->inertia_inverse[0] - v->precession[0] * (w[1] * w[2]);
    slope->rate[1] = ty * v->inertia_inverse[1] - v->precession[1] * (w[2] * w[0]);
    slope->rate[2] = tz * v->inertia_inverse[2] - v->precession[2] * (w[0] * w[1]);
}

INLINE void advance(body *to, const body *from, const body *slope, double h) {
    vec *x = (vec *)to;
    const vec *x0 = (const vec *)from, *dx = (const vec *)slope;
    for (unsigned i = 0; i < BODY_VECS; i++) x[i] = x0[i] + R(h) * dx[i];
}

/* One sample; f is the frame of b, before and after. */
INLINE void integrate(const vehicle *v, body *b, frame *f, const vec *command, const real *wind) {
    const double h = SAMPLE_TIME;
    body slope;
#if EULER /* velocities first, then everything else with the new velocities */
    dynamics(v, b, f, command, wind, &slope);
    for (int i = 0; i < 3; i++) {
        b->velocity[i] += R(h) * slope.velocity[i];
        b->rate[i] += R(h) * slope.rate[i];
        slope.velocity[i] = slope.rate[i] = fill(0);
    }
    *f = look(b);
    kinematics(b, f, command, &slope);
    advance(b, b, &slope, h);
#else /* classical Runge-Kutta */
    body at = *b, sum = *b;
    for (int stage = 0; stage < 4; stage++) {
        kinematics(&at, f, command, &slope);
        dynamics(v, &at, f, command, wind, &slope);
        advance(&sum, &sum, &slope, stage == 0 || stage == 3 ? h / 6 : h / 3);
        if (stage == 3) break;
        advance(&at, b, &slope, stage == 2 ? h : h / 2);
        *f = look(&at);
    }
    *b = sum;
#endif
    vec *q = b->attitude, inverse = R(1) / root(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int i = 0; i < 4; i++) q[i] *= inverse;
    *f = look(b);
}

INLINE vec total(const body *b, const channel *c) {
    vec sum = fill(0);
    for (unsigned i = 0; i < BODY_VECS; i++) sum += ((const vec *)b)[i];
    for (int i = 0; i < CHANNELS; i++) sum += c[i].u_av + c[i].sigma_hat;
    return sum;
}

/* LANES draws from start to end. */
INLINE void simulate(const real *drawn, const point *wanted, long samples, long first, results out) {
    const vehicle v = prepare(drawn, out);
    body b = {0};
    channel c[CHANNELS] = {0};
    survival s = {ALL, fill(0)};
    for (int i = 0; i < 3; i++) b.position[i] = fill(R(LOOP.position[i])), b.velocity[i] = fill(R(LOOP.velocity[i]));
    b.attitude[0] = fill(R(cos(0.5 * LOOP.yaw))), b.attitude[3] = fill(R(sin(0.5 * LOOP.yaw)));
    frame f = look(&b);
    for (long k = 0; k < samples && any(s.alive); k++, wanted += CHANNELS) {
        const real on = begun(LOOP.wind_from, k);
        const real wind[3] = {on * R(LOOP.wind[0]), on * R(LOOP.wind[1]), on * R(LOOP.wind[2])};
        vec psi = wrapped(atan_full(f.r[1][0], f.r[0][0]) - wanted[3].y), command[CHANNELS];
        for (int i = 0; i < 3; i++)
            command[i] = control(&LOOP.channel[i], &c[i], b.position[i] - wanted[i].y, b.velocity[i], &wanted[i], k == 0);
        command[3] = control(&LOOP.channel[3], &c[3], psi, f.dpsi, &wanted[3], k == 0);
        integrate(&v, &b, &f, command, wind);
        mask finite = above(fill(LARGEST), size(total(&b, c))), upright = above(f.r[2][2], fill(R(LEAST_UPRIGHT)));
        survive(&s, finite, upright, out, first);
    }
    report(&s, c, samples, out, first);
}
