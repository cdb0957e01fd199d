/* The linear algebra of an interior-point step: a Riccati recursion over the nodes of a window.
 *
 * A node has the steps of its positions and of the free durations, q = [Q; tau], and of its velocities v. The control
 * of an interval is the velocity w at its end:
 *
 *     Q+ = Q + a v + b w + Gamma tau,   v+ = w.
 *
 * So a large weight on velocities, of a bound that is active, stands in the matrix that is factorized and nowhere
 * else, and cancels no digits. v acts as a shift of Q by a v and in R (w - v)^2 / 2 alone: what is eliminated has q's
 * columns, and those of v follow. N (coordinates) and S (durations) are compile-time constants.
 */
#include <float.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

/* The names of functions for callers end with the sizes, so that kernels of several sizes go into one program. */
#define JOIN(name, n, s) name##_##n##_##s
#define EXPAND(name, n, s) JOIN(name, n, s)
#define SIZED(name) EXPAND(name, N, S)

#define WIDTH 4
typedef double vec __attribute__((vector_size(8 * WIDTH), may_alias));

#define PADDED(a) (((a) + WIDTH - 1) / WIDTH * WIDTH)
#define M (2 * N)
#define NC PADDED(N)
#define D PADDED(N + S)
#define NV (NC / WIDTH)
#define DV (D / WIDTH)
#define TV (NV + DV + NV)

/* What the elimination of an interval's control leaves for the sweeps: rows of the gain -A^-1 Z (N, D), then of -A^-1
 * (N, NC), with the Hessian A = R + B'PB by the control and its coupling Z = B'P to q. */
typedef struct {
    vec row[N][DV + NV];
} IntervalFactors;

/* The Hessian P of the cost to go from a node: by q, by v and q, and the upper triangle of that by v. Rows after the
 * last are 0. */
typedef struct {
    vec q[D][DV], vq[NC][DV], v[NC][NV];
} ValueFunction;

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
    int64_t node_rows;
    const int64_t *row_node;    /* node of each row of the constraints at nodes, counted from node 1, ascending */
    const double *row_jacobian;     /* of these rows by [Q; v] at their nodes, (node_rows, 2N) */
    const double *row_weights;  /* what they add to the Hessian: weight row'row, (node_rows,) */
} RiccatiData;

static inline double *scalars(vec *row) { return (double *)row; }
static inline const double *const_scalars(const vec *row) { return (const double *)row; }

/* Subtract a product of two blocks of T, a few rows by a few vectors in registers:
 *
 *     to[r] -= sum over l of T[l][column + r] T[l][at ..]. */
static inline __attribute__((always_inline)) void subtract_tile(const vec T[N][TV], int begin, int end, int column,
                                                                int at,
                                                       int rows, int vectors, vec *to, int stride) {
    vec sum[WIDTH][3];
    for (int r = 0; r < rows; r++)
        for (int j = 0; j < vectors; j++) sum[r][j] = to[r * stride + j];
    for (int l = begin; l < end; l++)
        for (int r = 0; r < rows; r++)
            for (int j = 0; j < vectors; j++) sum[r][j] -= const_scalars(T[l])[column + r] * T[l][at + j];
    for (int r = 0; r < rows; r++)
        for (int j = 0; j < vectors; j++) to[r * stride + j] = sum[r][j];
}

/* The same with the vectors T[l][first .. last). */
static inline __attribute__((always_inline)) void subtract_strip(const vec T[N][TV], int begin, int end, int column,
                                                                 int first,
                                                        int last, int rows, vec *to, int stride) {
    for (; first + 2 < last; first += 3, to += 3) subtract_tile(T, begin, end, column, first, rows, 3, to, stride);
    if (last - first == 2) subtract_tile(T, begin, end, column, first, rows, 2, to, stride);
    if (last - first == 1) subtract_tile(T, begin, end, column, first, rows, 1, to, stride);
}

/* The same with the rows of one block of N rows; the last block may be smaller. */
static inline __attribute__((always_inline)) void subtract_rows(const vec T[N][TV], int begin, int end, int column,
                                                                int first, int last, int block, vec *to, int stride) {
    if ((block + 1) * WIDTH <= N) subtract_strip(T, begin, end, column, first, last, WIDTH, to, stride);
    else subtract_strip(T, begin, end, column, first, last, N % WIDTH, to, stride);
}

/* The transpose of a square block. */
static inline void transpose(const vec *from, int stride, vec to[WIDTH]) {
    for (int r = 0; r < WIDTH; r++)
        to[r] = (vec){from[0][r], from[stride][r], from[2 * stride][r], from[3 * stride][r]};
}

/* Add the cost of node k + 1 to the cost to go: its Hessian, the weights of its bounds, and weight c'c for each row c
 * of the constraints there. `last` counts the rows that are left. */
static void add_node_cost(const RiccatiData *s, int64_t k, int64_t *last, ValueFunction *P) {
    const double *arrow = s->arrow + k * M * S;
    for (int i = 0; i < N; i++) {
        for (int j = 0; j < NV; j++) P->q[i][j] += s->positions[(k * N + i) * NV + j];
        scalars(P->q[i])[i] += s->diagonal[k * M + i];
        scalars(P->v[i])[i] += s->diagonal[k * M + N + i];
        for (int c = 0; c < S; c++) {
            scalars(P->q[i])[N + c] += arrow[i * S + c];
            scalars(P->q[N + c])[i] += arrow[i * S + c];
            scalars(P->vq[i])[N + c] += arrow[(N + i) * S + c];
        }
    }
    for (; *last > 0 && s->row_node[*last - 1] == k; --*last) {
        const double *row = s->row_jacobian + (*last - 1) * M;
        const double *by_v = row + N;
        for (int i = 0; i < N; i++) {
            double share = s->row_weights[*last - 1] * row[i];
            double share_v = s->row_weights[*last - 1] * by_v[i];
            for (int j = 0; j < N && share != 0.0; j++) scalars(P->q[i])[j] += share * row[j];
            for (int j = 0; j < N && share_v != 0.0; j++) {
                scalars(P->vq[i])[j] += share_v * row[j];
                scalars(P->v[i])[j] += share_v * by_v[j];
            }
        }
    }
}

/* Substitute Q + Gamma tau for Q in the cost to go: P <- E'P E with E = [1 Gamma; 0 1] on q. */
static void apply_duration_drift(const double *gap_tau, ValueFunction *P) {
    for (int c = 0; c < S; c++) {
        vec gamma[NV];
        memset(gamma, 0, sizeof gamma);
        for (int j = 0; j < N; j++) scalars(gamma)[j] = -gap_tau[j * S + c];
        for (int j = 0; j < N; j++)
            for (int v = 0; v < DV; v++) P->q[N + c][v] += const_scalars(gamma)[j] * P->q[j][v];
        for (int i = 0; i < N; i++) {
            vec sum = P->vq[i][0] * gamma[0];
            for (int v = 1; v < NV; v++) sum += P->vq[i][v] * gamma[v];
            scalars(P->vq[i])[N + c] += (sum[0] + sum[1]) + (sum[2] + sum[3]);
        }
    }
    for (int c = 0; c < S; c++)
        for (int j = 0; j < N; j++) {
            for (int e = 0; e < S; e++)
                scalars(P->q[N + c])[N + e] -= const_scalars(P->q[N + c])[j] * gap_tau[j * S + e];
            scalars(P->q[j])[N + c] = const_scalars(P->q[N + c])[j];
        }
}

/* Factorize the Hessian by the control of an interval, A = L L', and form
 *
 *     T = L^-1 [A Z 1],   A = R + P_vv + b (P_vq + P_qv) + b^2 P_qq,   Z = b P_qq + P_vq.
 *
 * Returns 0 where A is not positive definite. The Riccati recursion of Rawlings, Mayne, Diehl: Model Predictive Control
 * (2017), section 8.8, with the velocity at the interval's end as control. */
static int eliminate_control(const ValueFunction *P, double b, const double *R, vec T[N][TV]) {
    for (int i = 0; i < N; i++) {
        for (int v = 0; v < DV; v++) T[i][NV + v] = b * P->q[i][v] + P->vq[i][v];
        for (int v = 0; v < NV; v++) T[i][v] = P->v[i][v] + b * T[i][NV + v], T[i][NV + DV + v] = (vec){0};
        scalars(T[i])[i] += R[i];
        scalars(T[i])[NC + D + i] = 1.0;
    }
    for (int block = 0; block < NV; block++) {
        int p = block * WIDTH;
        int last = NV + DV + block + 1;
        for (int other = block; other < NV; other++) {
            vec turned[WIDTH];
            transpose(P->vq[other * WIDTH] + block, DV, turned);
            for (int r = 0; r < WIDTH && p + r < N; r++) T[p + r][other] += b * turned[r];
        }
        subtract_rows(T, 0, p, p, block, last, block, T[p] + block, TV);
        for (int l = p; l < p + WIDTH && l < N; l++) {
            double pivot = const_scalars(T[l])[l];
            if (!(pivot > DBL_MIN)) return 0;
            double scale = 1.0 / sqrt(pivot);
            for (int v = block; v < last; v++) T[l][v] *= scale;
            for (int i = l + 1; i < p + WIDTH && i < N; i++) {
                double f = const_scalars(T[l])[i];
                for (int v = block; v < last; v++) T[i][v] -= f * T[l][v];
            }
        }
    }
    return 1;
}

/* Form the cost to go at the node before, and the gains of the interval:
 *
 *     P <- P - Z'A^-1 Z by q;   gains -A^-1 Z and -A^-1.
 *
 * The velocity v before stands for a shift of Q by a v and for the cost R (w - v)^2 / 2, of which the blocks by v
 * follow from those by q and from the gains. */
static void value_before_interval(const vec T[N][TV], double a, const double *R, ValueFunction *P,
                                  IntervalFactors *to) {
    vec padded[NC][DV + NV], weight[NV], (*G)[DV + NV] = N < NC ? padded : to->row;
    memset(G, 0, sizeof padded);
    memset(weight, 0, sizeof weight);
    memcpy(weight, R, N * sizeof(double));
    for (int block = 0; block < NV; block++) {
        int p = block * WIDTH;
        subtract_rows(T, p, N, NC + D + p, NV, NV + DV + block + 1, block, G[p], DV + NV);
        for (int other = 0; other < block; other++) {
            vec turned[WIDTH];
            transpose(G[p] + DV + other, DV + NV, turned);
            for (int r = 0; r < WIDTH; r++) G[other * WIDTH + r][DV + block] = turned[r];
        }
    }
    if (N < NC) memcpy(to, G, sizeof *to);
    for (int block = 0; block < DV; block++) {
        int p = block * WIDTH;
        subtract_strip(T, 0, N, NC + p, NV + block, NV + DV, WIDTH, P->q[p] + block, DV);
        for (int other = block + 1; other < DV; other++) {
            vec turned[WIDTH];
            transpose(P->q[p] + other, DV, turned);
            for (int r = 0; r < WIDTH; r++) P->q[other * WIDTH + r][block] = turned[r];
        }
    }
    for (int i = 0; i < N; i++)
        for (int v = 0; v < DV; v++) P->vq[i][v] = a * P->q[i][v] - R[i] * G[i][v];
    for (int block = 0; block < NV; block++)
        for (int other = block; other < NV; other++) {
            vec turned[WIDTH];
            transpose(P->vq[other * WIDTH] + block, DV, turned);
            for (int r = 0, i = block * WIDTH; r < WIDTH && i < N; r++, i++)
                P->v[i][other] = a * (P->vq[i][other] + turned[r] - a * P->q[i][other]) +
                                 R[i] * weight[other] * G[i][DV + other];
        }
    for (int i = 0; i < N; i++) scalars(P->v[i])[i] += R[i];
}

/* Run the Riccati recursion from the last interval to the first; `schur` (S, S) is the Hessian by the durations that is
 * left. Returns 0 where some Hessian by a control is not positive definite. */
static int riccati_factorize(const RiccatiData *s, IntervalFactors *intervals, double *schur) {
    ValueFunction P;
    vec T[N][TV];
    int64_t last = s->node_rows;
    memset(&P, 0, sizeof P);
    for (int c = 0; c < S; c++)
        for (int e = 0; e < S; e++) scalars(P.q[N + c])[N + e] = s->durations[c * S + e];
    for (int64_t k = s->K - 1; k >= 0; k--) {
        double a = -s->gap_velocity[2 * k];
        double b = -s->gap_velocity[2 * k + 1];
        const double *R = s->difference + k * N;
        add_node_cost(s, k, &last, &P);
        apply_duration_drift(s->gap_tau + k * N * S, &P);
        if (!eliminate_control(&P, b, R, T)) return 0;
        value_before_interval(T, a, R, &P, intervals + k);
    }
    for (int c = 0; c < S; c++)
        for (int e = 0; e < S; e++) schur[c * S + e] = const_scalars(P.q[N + c])[N + e];
    return 1;
}

/* Sweep backward with a gradient (K, 2N) at nodes 1 .. K: the gradient p of the cost to go,
 *
 *     r = B'p,   p <- A'p + (gain)' r.
 *
 * `y` (K, NC) keeps r, the derivatives by the controls; what is left by the durations is added to `u` (S,). */
static void riccati_backward(const RiccatiData *s, const IntervalFactors *intervals, const double *gradient, double *u,
                             double *y) {
    vec p[DV + NV];
    double *q = scalars(p);
    double *v = q + D;
    memset(p, 0, sizeof p);
    for (int c = 0; c < S; c++) q[N + c] = u[c];
    for (int64_t k = s->K - 1; k >= 0; k--) {
        double a = -s->gap_velocity[2 * k];
        double b = -s->gap_velocity[2 * k + 1];
        double *r = y + k * NC;
        for (int i = 0; i < N; i++) q[i] += gradient[k * M + i];
        for (int i = 0; i < N; i++) r[i] = b * q[i] + v[i] + gradient[k * M + N + i];
        for (int i = N; i < NC; i++) r[i] = 0.0;
        for (int j = 0; j < N; j++)
            for (int c = 0; c < S; c++) q[N + c] -= s->gap_tau[(k * N + j) * S + c] * q[j];
        memset(v, 0, NC * sizeof(double));
        for (int i = 0; i < N; i++)
            for (int j = 0; j < DV + NV; j++) p[j] += r[i] * intervals[k].row[i][j];
        for (int i = 0; i < N; i++) v[i] = a * q[i] - s->difference[k * N + i] * v[i];
    }
    for (int c = 0; c < S; c++) u[c] = q[N + c];
}

/* Sweep forward: the controls w = -A^-1 (Z q + r) of the intervals, and the steps X (K, 2N) that they lead through at
 * nodes 1 .. K, for steps `tau` of the durations. */
static void riccati_forward(const RiccatiData *s, const IntervalFactors *intervals, const double *tau, const double *y,
                            double *X) {
    vec x[DV + NV];
    double *q = scalars(x);
    double *m = q + D;
    double v[N] = {0};
    memset(x, 0, sizeof x);
    for (int c = 0; c < S; c++) q[N + c] = tau[c];
    for (int64_t k = 0; k < s->K; k++) {
        double a = -s->gap_velocity[2 * k];
        double b = -s->gap_velocity[2 * k + 1];
        for (int i = 0; i < N; i++) {
            q[i] += a * v[i];
            m[i] = y[k * NC + i] - s->difference[k * N + i] * v[i];
        }
        for (int i = 0; i < N; i++) {
            vec sum = intervals[k].row[i][0] * x[0];
            for (int j = 1; j < DV + NV; j++) sum += intervals[k].row[i][j] * x[j];
            v[i] = (sum[0] + sum[1]) + (sum[2] + sum[3]);
        }
        for (int i = 0; i < N; i++) {
            q[i] += b * v[i];
            for (int c = 0; c < S; c++) q[i] -= s->gap_tau[(k * N + i) * S + c] * tau[c];
        }
        memcpy(X + k * M, q, N * sizeof(double));
        memcpy(X + k * M + N, v, N * sizeof(double));
    }
}
