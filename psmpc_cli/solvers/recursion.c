/* The linear algebra of an interior-point step: a Riccati recursion over the nodes of a window.
 *
 * A node's vector is y = [Q; v; tau], N + N + S numbers, padded with zeros to C of them: steps of positions, of
 * velocities and of the free durations. The control of an interval is the velocity w at its end:
 *
 *     Q+ = Q + a v + b w + Gamma tau,   v+ = w.
 *
 * So a large weight on velocities, of a bound that is active, stands in the matrix that is factorized and nowhere
 * else, and cancels no digits. N (coordinates) and S (durations) are compile-time constants.
 */
#include <float.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

#define WIDTH 4
typedef double vec __attribute__((vector_size(8 * WIDTH), may_alias));

#define PADDED(a) (((a) + WIDTH - 1) / WIDTH * WIDTH)
#define M (2 * N)
#define C PADDED(M + S)
#define NC PADDED(N)
#define CV (C / WIDTH)
#define NV (NC / WIDTH)

/* What an interval leaves of its elimination, L L' = R + B'PB: Y = L^-1 (B'PF - R on v), J = L^-1. */
typedef struct {
    vec Y[N][CV];
    vec J[N][NV];
} Interval;

/* The matrices of the quadratic program that a recursion reads. */
typedef struct {
    int64_t K;
    const vec *positions;       /* Hessian by Q at nodes 1 .. K, (K, N, NC) */
    const double *diagonal;     /* what is added to the Hessian by [Q; v] at nodes 1 .. K, (K, 2N) */
    const double *arrow;        /* Hessian by [Q; v] and tau at nodes 1 .. K, (K, 2N, S) */
    const double *durations;    /* Hessian by tau, (S, S) */
    const double *difference;   /* R, weights of (w - v)^2 / 2, (K, N) */
    const double *gap_velocity; /* -a and -b, (K, 2) */
    const double *gap_tau;      /* -Gamma, (K, N, S) */
    int64_t ends;
    const int64_t *end_node;    /* node of each end row, counted from node 1, ascending */
    const double *end_rows;     /* (ends, 2N) */
    const double *end_weights;  /* (ends,) */
} Stages;

static inline double *numbers(vec *row) { return (double *)row; }
static inline const double *values(const vec *row) { return (const double *)row; }

/* Add the cost of node k + 1 to the value function P; `last` counts the end rows that are left. */
static void add_node(const Stages *q, int64_t k, int64_t *last, vec P[C][CV]) {
    for (int i = 0; i < N; i++)
        for (int j = 0; j < NV; j++) P[i][j] += q->positions[(k * N + i) * NV + j];
    for (int i = 0; i < M; i++) numbers(P[i])[i] += q->diagonal[k * M + i];
    for (int i = 0; i < M; i++)
        for (int c = 0; c < S; c++) {
            numbers(P[i])[M + c] += q->arrow[(k * M + i) * S + c];
            numbers(P[M + c])[i] += q->arrow[(k * M + i) * S + c];
        }
    for (; *last > 0 && q->end_node[*last - 1] == k; --*last) {
        const double *row = q->end_rows + (*last - 1) * M;
        for (int i = 0; i < M; i++) {
            double share = q->end_weights[*last - 1] * row[i];
            if (share != 0.0)
                for (int j = 0; j < M; j++) numbers(P[i])[j] += share * row[j];
        }
    }
}

/* G = P F: columns by the vector of the node before. */
static void by_node_before(const vec P[C][CV], double a, const double *gap_tau, vec G[C][CV]) {
    vec drift[S + 1][CV];
    memset(drift, 0, sizeof drift);
    for (int j = 0; j < N; j++)
        for (int c = 0; c < S; c++)
            for (int v = 0; v < CV; v++) drift[c][v] -= gap_tau[j * S + c] * P[j][v];
    for (int i = 0; i < M + S; i++) {
        const double *row = values(P[i]);
        double *to = numbers(G[i]);
        for (int j = 0; j < N; j++) to[j] = row[j];
        for (int j = 0; j < N; j++) to[N + j] = a * row[j];
        for (int c = 0; c < S; c++) to[M + c] = row[M + c] + values(drift[c])[i];
        for (int j = M + S; j < C; j++) to[j] = 0.0;
    }
}

/* Eliminate the control: A = R + B'PB is factorized, Y and J are solved for. Returns 0 where A is not positive. */
static int eliminate(const vec P[C][CV], const vec G[C][CV], double b, const double *R, Interval *to) {
    vec A[N][NV];
    for (int i = 0; i < N; i++) {
        vec Z[CV];
        for (int v = 0; v < CV; v++) Z[v] = b * P[i][v] + P[N + i][v];
        for (int j = 0; j < N; j++) numbers(A[i])[j] = b * values(Z)[j] + values(Z)[N + j];
        for (int j = N; j < NC; j++) numbers(A[i])[j] = 0.0;
        numbers(A[i])[i] += R[i];
        for (int v = 0; v < CV; v++) to->Y[i][v] = b * G[i][v] + G[N + i][v];
        numbers(to->Y[i])[N + i] -= R[i];
        memset(to->J[i], 0, sizeof to->J[i]);
        numbers(to->J[i])[i] = 1.0;
    }
    for (int l = 0; l < N; l += 2) {
        for (int p = l; p < l + 2 && p < N; p++) {
            double pivot = values(A[p])[p];
            if (!(pivot > DBL_MIN)) return 0;
            double scale = 1.0 / sqrt(pivot);
            for (int v = p / WIDTH; v < NV; v++) A[p][v] *= scale;
            for (int v = 0; v <= p / WIDTH; v++) to->J[p][v] *= scale;
            for (int v = 0; v < CV; v++) to->Y[p][v] *= scale;
            if (p > l || p + 1 == N) break;
            double f = values(A[p])[p + 1];
            for (int v = (p + 1) / WIDTH; v < NV; v++) A[p + 1][v] -= f * A[p][v];
            for (int v = 0; v <= p / WIDTH; v++) to->J[p + 1][v] -= f * to->J[p][v];
            for (int v = 0; v < CV; v++) to->Y[p + 1][v] -= f * to->Y[p][v];
        }
        for (int i = l + 2; i < N; i++) { /* two pivots at a time: half the loads and stores */
            double f = values(A[l])[i], g = values(A[l + 1])[i];
            for (int v = i / WIDTH; v < NV; v++) A[i][v] -= f * A[l][v] + g * A[l + 1][v];
            for (int v = 0; v < CV; v++) to->Y[i][v] -= f * to->Y[l][v] + g * to->Y[l + 1][v];
            for (int v = 0; v <= (l + 1) / WIDTH; v++) to->J[i][v] -= f * to->J[l][v] + g * to->J[l + 1][v];
        }
    }
    return 1;
}

/* P = F'G + R on v - Y'Y, the value function at the node before. */
static void step_back(const vec G[C][CV], const Interval *at, double a, const double *gap_tau, const double *R,
                      vec P[C][CV]) {
    for (int i = 0; i < N; i++)
        for (int v = 0; v < CV; v++) P[i][v] = G[i][v], P[N + i][v] = a * G[i][v];
    for (int c = 0; c < S; c++)
        for (int v = 0; v < CV; v++) {
            vec sum = G[M + c][v];
            for (int j = 0; j < N; j++) sum -= gap_tau[j * S + c] * G[j][v];
            P[M + c][v] = sum;
        }
    for (int i = 0; i < N; i++) numbers(P[N + i])[N + i] += R[i];
    for (int block = 0; block < CV; block++) {
        int v = block;
        for (; v + 1 < CV; v += 2) { /* four rows by two vectors stay in registers */
            vec sum[WIDTH][2];
            for (int r = 0; r < WIDTH; r++)
                for (int j = 0; j < 2; j++) sum[r][j] = P[block * WIDTH + r][v + j];
            for (int l = 0; l < N; l++)
                for (int r = 0; r < WIDTH; r++)
                    for (int j = 0; j < 2; j++) sum[r][j] -= values(at->Y[l])[block * WIDTH + r] * at->Y[l][v + j];
            for (int r = 0; r < WIDTH; r++)
                for (int j = 0; j < 2; j++) P[block * WIDTH + r][v + j] = sum[r][j];
        }
        for (; v < CV; v++) {
            vec sum[WIDTH];
            for (int r = 0; r < WIDTH; r++) sum[r] = P[block * WIDTH + r][v];
            for (int l = 0; l < N; l++)
                for (int r = 0; r < WIDTH; r++) sum[r] -= values(at->Y[l])[block * WIDTH + r] * at->Y[l][v];
            for (int r = 0; r < WIDTH; r++) P[block * WIDTH + r][v] = sum[r];
        }
        for (int i = (block + 1) * WIDTH; i < M + S; i++) /* the lower triangle is the upper one's image */
            for (int r = 0; r < WIDTH; r++) numbers(P[i])[block * WIDTH + r] = values(P[block * WIDTH + r])[i];
    }
}

/* Factorize; `U` (S, S) is what is left by the durations. Returns 0 where the Hessian is not positive. */
static int factorize(const Stages *q, Interval *intervals, double *U) {
    vec P[C][CV], G[C][CV];
    int64_t last = q->ends;
    memset(P, 0, sizeof P);
    memset(G, 0, sizeof G);
    for (int c = 0; c < S; c++)
        for (int e = 0; e < S; e++) numbers(P[M + c])[M + e] = q->durations[c * S + e];
    for (int64_t k = q->K - 1; k >= 0; k--) {
        double a = -q->gap_velocity[2 * k], b = -q->gap_velocity[2 * k + 1];
        const double *gap_tau = q->gap_tau + k * N * S, *R = q->difference + k * N;
        add_node(q, k, &last, P);
        by_node_before(P, a, gap_tau, G);
        if (!eliminate(P, G, b, R, intervals + k)) return 0;
        step_back(G, intervals + k, a, gap_tau, R, P);
    }
    for (int c = 0; c < S; c++)
        for (int e = 0; e < S; e++) U[c * S + e] = values(P[M + c])[M + e];
    return 1;
}

/* out = L^-1 r and out = L^-T r. */
static inline void apply(const Interval *at, const double *r, double *out) {
    for (int i = 0; i < N; i++) {
        vec sum = at->J[i][0] * *(const vec *)r;
        for (int v = 1; v <= i / WIDTH; v++) sum += at->J[i][v] * ((const vec *)r)[v];
        out[i] = (sum[0] + sum[1]) + (sum[2] + sum[3]);
    }
}

static inline void apply_transposed(const Interval *at, const double *r, double *out) {
    vec sum[NV];
    for (int v = 0; v < NV; v++) sum[v] = (vec){0};
    for (int i = 0; i < N; i++)
        for (int v = 0; v <= i / WIDTH; v++) sum[v] += r[i] * at->J[i][v];
    memcpy(out, sum, sizeof sum);
}

/* Backward: `gradient` (K, 2N) by nodes 1 .. K. `u` (S,) gets added what is left by the durations, `y` (K, NC) kept. */
static void backward(const Stages *q, const Interval *intervals, const double *gradient, double *u, double *y) {
    vec p[CV], r[NV];
    memset(p, 0, sizeof p);
    memset(r, 0, sizeof r);
    for (int c = 0; c < S; c++) numbers(p)[M + c] = u[c];
    for (int64_t k = q->K - 1; k >= 0; k--) {
        double a = -q->gap_velocity[2 * k], b = -q->gap_velocity[2 * k + 1], *at = y + k * NC, *to = numbers(p);
        const Interval *interval = intervals + k;
        for (int i = 0; i < M; i++) to[i] += gradient[k * M + i];
        for (int i = 0; i < N; i++) numbers(r)[i] = b * to[i] + to[N + i];
        apply(interval, values(r), at);
        for (int j = 0; j < N; j++)
            for (int c = 0; c < S; c++) to[M + c] -= q->gap_tau[(k * N + j) * S + c] * to[j];
        for (int i = 0; i < N; i++) to[N + i] = a * to[i];
        for (int i = 0; i < N; i++)
            for (int v = 0; v < CV; v++) p[v] -= at[i] * interval->Y[i][v];
    }
    for (int c = 0; c < S; c++) u[c] = values(p)[M + c];
}

/* Forward: the steps X (K, 2N) of nodes 1 .. K for steps `tau` of the durations. */
static void forward(const Stages *q, const Interval *intervals, const double *tau, const double *y, double *X) {
    vec x[CV], r[NV], w[NV];
    memset(x, 0, sizeof x);
    memset(r, 0, sizeof r);
    for (int c = 0; c < S; c++) numbers(x)[M + c] = tau[c];
    for (int64_t k = 0; k < q->K; k++) {
        double a = -q->gap_velocity[2 * k], b = -q->gap_velocity[2 * k + 1], *at = numbers(x);
        const Interval *interval = intervals + k;
        for (int i = 0; i < N; i++) {
            vec sum = interval->Y[i][0] * x[0];
            for (int v = 1; v < CV; v++) sum += interval->Y[i][v] * x[v];
            numbers(r)[i] = -y[k * NC + i] - ((sum[0] + sum[1]) + (sum[2] + sum[3]));
        }
        apply_transposed(interval, values(r), numbers(w));
        for (int i = 0; i < N; i++) {
            double drift = a * at[N + i] + b * values(w)[i];
            for (int c = 0; c < S; c++) drift -= q->gap_tau[(k * N + i) * S + c] * tau[c];
            at[i] += drift;
            at[N + i] = values(w)[i];
        }
        memcpy(X + k * M, at, M * sizeof(double));
    }
}
