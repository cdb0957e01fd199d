/* The Riccati recursion that solves the Newton equations of an interior-point method over the nodes of a window.
 *
 * The unknowns at a node are the steps of its positions and of the free durations, q = [Q; tau], and of its velocities
 * v. Nodes 0 .. K are joined by K intervals; the steps at node 0 are 0. The control of an interval is w, the velocity
 * at its end:
 *
 *     Q+ = Q + a v + b w + Gamma tau,   v+ = w,   tau+ = tau.
 *
 * The problem is
 *
 *     min  sum over nodes 1 .. K of  1/2 [q; v]' H [q; v] + g' [q; v]
 *        + sum over intervals of     1/2 (w - v)' R (w - v).
 *
 * The value function 1/2 [q; v]' P [q; v] + p' [q; v] of each node follows backward from that of the next: Rawlings,
 * Mayne, Diehl: Model Predictive Control (2017), section 8.8. With the velocity as control, a large weight
 * on a velocity, which a bound that is active has, stands in the matrix that is factorized and nowhere else, and
 * cancels no digits. v acts in two places alone: it shifts Q by a v, and it stands in (w - v)' R (w - v) / 2. So only
 * the columns of q are eliminated, and the blocks by v follow from them.
 *
 * N (coordinates), S_MAX (the most free durations) and HISTORY are compile-time constants; a program has S durations.
 * HISTORY is N where constraints couple an interval with the one before, see interval_rows.c, else 0. Arrays are stored
 * row by row; what is marked as padded has rows of a whole number of vectors, whose surplus entries are 0.
 */
#include <float.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

/* Functions with external linkage carry the sizes in their names, name_N_S_MAX_HISTORY, so that kernels of several sizes
 * can be linked into one program. All others are static. */
#define JOIN(name, coordinates, durations, history) name##_##coordinates##_##durations##_##history
#define EXPAND(name, coordinates, durations, history) JOIN(name, coordinates, durations, history)
#define SIZED(name) EXPAND(name, N, S_MAX, HISTORY)

#define INLINE static inline __attribute__((always_inline))

/* Functions whose loops take most of the time are compiled on their own: inlined into a large caller, they would have
 * fewer registers. */
#define NOINLINE static __attribute__((noinline))

/* Doubles of a vector register. Rows of few entries, padded to 8, would take longer than what wider registers save. */
#if defined(__AVX512F__) && N >= 16
#define LANES 8
#else
#define LANES 4
#endif
typedef double vec __attribute__((vector_size(8 * LANES), may_alias));

#define PADDED(count) (((count) + LANES - 1) / LANES * LANES)
#define NX (2 * N)                /* entries of a state [Q; v] */
#define N_PADDED PADDED(N)        /* of v, padded */
#define NQ_PADDED PADDED(N + S_MAX + HISTORY) /* of q = [Q; tau; z], padded; z is that of interval_rows.c */
#define HISTORY_COLUMN (N + S_MAX)    /* of z in q */
#define N_VECS (N_PADDED / LANES) /* vectors of the same */
#define NQ_VECS (NQ_PADDED / LANES)

/* The tableau [A Z 1] of an elimination has N rows: A (N, N), Z (N, N + S), identity (N, N), each of them padded. */
#define Z_COLUMN N_PADDED
#define IDENTITY_COLUMN (N_PADDED + NQ_PADDED)
#define Z_VEC N_VECS
#define IDENTITY_VEC (N_VECS + NQ_VECS)
#define TABLEAU_VECS (N_VECS + NQ_VECS + N_VECS)

/* The feedback law of an interval, w = -A^-1 (Z q + r): rows of the gains [-A^-1 Z, -A^-1], (N, N + S) and (N, N), both
 * padded. A = R + B'PB is the Hessian by the control, Z = B'P its coupling to q. */
typedef struct {
    vec gain[N][NQ_VECS + N_VECS];
} IntervalGains;

/* The Hessian P of the value function at a node. Rows after the last are 0. */
typedef struct {
    vec qq[NQ_PADDED][NQ_VECS]; /* by q and q, (N + S, N + S) */
    vec vq[N_PADDED][NQ_VECS];  /* by v and q, (N, N + S) */
    vec vv[N_PADDED][N_VECS];   /* by v and v, the upper triangle, (N, N) */
} ValueFunction;

/* The matrices that the recursion reads. Constraints at nodes add weight c'c to the Hessian of their node. */
typedef struct {
    int64_t K;                    /* intervals */
    int64_t S;                    /* free durations */
    const vec *H_QQ;              /* Hessian by Q at nodes 1 .. K, (K, N, N), padded */
    const double *state_weights;  /* what is added to the diagonal of the Hessian by [Q; v] there, (K, 2N) */
    const double *H_x_tau;        /* Hessian by [Q; v] there and tau, (K, 2N, S) */
    const double *H_tau_tau;      /* Hessian by tau, (S, S) */
    const double *R;              /* weights of (w - v)^2 / 2, (K, N) */
    const double *gap_velocity;   /* -a and -b, (K, 2) */
    const double *gap_tau;        /* -Gamma, (K, N, S) */
    int64_t node_row_count;       /* E, constraints at nodes */
    const int64_t *row_node;      /* node of each of them, counted from node 1, ascending, (E,) */
    const double *row_jacobian;   /* their derivatives c by [Q; v] at their nodes, (E, 2N) */
    const double *node_row_weights; /* their weights, (E,) */
} RiccatiData;

/* The entries of a row of vectors. */
static inline double *scalars(vec *row) { return (double *)row; }
static inline const double *const_scalars(const vec *row) { return (const double *)row; }

/* The sum of the entries of a vector. */
INLINE double sum_of_lanes(vec entries) {
    for (int half = LANES / 2; half > 0; half /= 2)
        for (int i = 0; i < half; i++) entries[i] += entries[i + half];
    return entries[0];
}

/* Subtract a product of two parts of a tableau T, few enough rows and vectors to stay in registers:
 *
 *     C[r] -= sum over first_row <= l < last_row of  T[l][left_column + r] T[l][right_vec ..],
 *
 * that is C -= X'Y with X (last_row - first_row, rows) and Y (last_row - first_row, vecs) in T. C (rows, vecs) has
 * C_stride vectors a row. Micro-kernel, panel and row of blocks below have these names from Goto, van de Geijn:
 * Anatomy of high-performance matrix multiplication (2008). */
INLINE void gemm_microkernel(const vec *T, int T_stride, int first_row, int last_row, int left_column, int right_vec,
                             int rows, int vecs, vec *C, int C_stride) {
    vec sum[LANES][3];
    for (int r = 0; r < rows; r++)
        for (int j = 0; j < vecs; j++) sum[r][j] = C[r * C_stride + j];
    for (int l = first_row; l < last_row; l++)
        for (int r = 0; r < rows; r++)
            for (int j = 0; j < vecs; j++) sum[r][j] -= const_scalars(T + l * T_stride)[left_column + r] * T[l * T_stride + right_vec + j];
    for (int r = 0; r < rows; r++)
        for (int j = 0; j < vecs; j++) C[r * C_stride + j] = sum[r][j];
}

/* Subtract the same product with any number of vectors, those from first_vec to before last_vec in T. */
INLINE void gemm_panel(const vec *T, int T_stride, int first_row, int last_row, int left_column, int first_vec,
                       int last_vec, int rows, vec *C, int C_stride) {
    for (; first_vec + 2 < last_vec; first_vec += 3) {
        gemm_microkernel(T, T_stride, first_row, last_row, left_column, first_vec, rows, 3, C, C_stride);
        C += 3;
    }
    int rest = last_vec - first_vec;
    if (rest == 2) gemm_microkernel(T, T_stride, first_row, last_row, left_column, first_vec, rows, 2, C, C_stride);
    if (rest == 1) gemm_microkernel(T, T_stride, first_row, last_row, left_column, first_vec, rows, 1, C, C_stride);
}

/* Subtract the same product for the rows of one block of N rows; the last block may have fewer than LANES. */
INLINE void gemm_block_row(const vec *T, int T_stride, int first_row, int last_row, int left_column, int first_vec,
                           int last_vec, int block, vec *C, int C_stride) {
    int is_full = (block + 1) * LANES <= N;
    if (is_full) gemm_panel(T, T_stride, first_row, last_row, left_column, first_vec, last_vec, LANES, C, C_stride);
    else gemm_panel(T, T_stride, first_row, last_row, left_column, first_vec, last_vec, N % LANES, C, C_stride);
}

/* Transpose a square block of LANES rows; `block` has `stride` vectors a row. */
static inline void transpose_block(const vec *block, int stride, vec transposed[LANES]) {
    for (int r = 0; r < LANES; r++)
        for (int c = 0; c < LANES; c++) transposed[r][c] = block[c * stride][r];
}

/* Add the Hessian of the costs at node k + 1 to that of the value function:
 *
 *     P += H_k+1 + diag(state_weights) + sum of  weight c'c  over the constraints at that node.
 *
 * `rows_left` counts the constraints that are not added yet, those of earlier nodes. */
static void add_node_cost(const RiccatiData *data, int64_t k, int64_t *rows_left, ValueFunction *P) {
    const int64_t S = data->S;
    const double *H_x_tau = data->H_x_tau + k * NX * S;
    for (int i = 0; i < N; i++) {
        for (int j = 0; j < N_VECS; j++) P->qq[i][j] += data->H_QQ[(k * N + i) * N_VECS + j];
        scalars(P->qq[i])[i] += data->state_weights[k * NX + i];
        scalars(P->vv[i])[i] += data->state_weights[k * NX + N + i];
        for (int c = 0; c < S; c++) {
            scalars(P->qq[i])[N + c] += H_x_tau[i * S + c];
            scalars(P->qq[N + c])[i] += H_x_tau[i * S + c];
            scalars(P->vq[i])[N + c] += H_x_tau[(N + i) * S + c];
        }
    }
    for (; *rows_left > 0 && data->row_node[*rows_left - 1] == k; --*rows_left) {
        double weight = data->node_row_weights[*rows_left - 1];
        const double *by_Q = data->row_jacobian + (*rows_left - 1) * NX;
        const double *by_v = by_Q + N;
        for (int i = 0; i < N; i++) {
            double weighted_Q = weight * by_Q[i];
            double weighted_v = weight * by_v[i];
            for (int j = 0; j < N && weighted_Q != 0.0; j++) scalars(P->qq[i])[j] += weighted_Q * by_Q[j];
            for (int j = 0; j < N && weighted_v != 0.0; j++) {
                scalars(P->vq[i])[j] += weighted_v * by_Q[j];
                scalars(P->vv[i])[j] += weighted_v * by_v[j];
            }
        }
    }
}

/* Substitute Q + Gamma tau for Q in the value function, the part of the dynamics that is due to the durations:
 *
 *     P_qq <- E' P_qq E,   P_vq <- P_vq E,   E = [1 Gamma; 0 1].
 *
 * `gap_tau` is -Gamma (N, S). */
static void substitute_durations(int64_t S, const double *gap_tau, ValueFunction *P) {
    for (int c = 0; c < S; c++) {
        vec gamma[N_VECS];
        memset(gamma, 0, sizeof gamma);
        for (int j = 0; j < N; j++) scalars(gamma)[j] = -gap_tau[j * S + c];
        for (int j = 0; j < N; j++)
            for (int v = 0; v < NQ_VECS; v++) P->qq[N + c][v] += const_scalars(gamma)[j] * P->qq[j][v];
        for (int i = 0; i < N; i++) {
            vec sum = P->vq[i][0] * gamma[0];
            for (int v = 1; v < N_VECS; v++) sum += P->vq[i][v] * gamma[v];
            scalars(P->vq[i])[N + c] += sum_of_lanes(sum);
        }
    }
    for (int c = 0; c < S; c++)
        for (int j = 0; j < N; j++) {
            for (int e = 0; e < S; e++)
                scalars(P->qq[N + c])[N + e] -= const_scalars(P->qq[N + c])[j] * gap_tau[j * S + e];
            scalars(P->qq[j])[N + c] = const_scalars(P->qq[N + c])[j];
        }
    for (int j = HISTORY_COLUMN; j < HISTORY_COLUMN + HISTORY; j++)
        for (int c = 0; c < S; c++) scalars(P->qq[j])[N + c] = const_scalars(P->qq[N + c])[j];
}

/* Factorize the first N columns of a tableau, A = L L', and multiply it by L^-1 from the left:
 *
 *     [A Z 1]  ->  L^-1 [A Z 1],
 *
 * by a Cholesky factorization in blocks of LANES rows: each block is first reduced by the rows before it, then within
 * itself. The identity begins at `identity_vec`; of A the blocks on and above the diagonal are read. Returns 0 where A
 * is not positive definite. */
INLINE int factorize_tableau(vec *T, int T_stride, int identity_vec) {
    for (int block = 0; block < N_VECS; block++) {
        int first = block * LANES;
        int last_vec = identity_vec + block + 1; /* L^-1 is lower triangular: it is 0 from there on */
        gemm_block_row(T, T_stride, 0, first, first, block, last_vec, block, T + first * T_stride + block, T_stride);
        for (int l = first; l < first + LANES && l < N; l++) {
            vec *row = T + l * T_stride;
            double pivot = const_scalars(row)[l];
            if (!(pivot > DBL_MIN)) return 0;
            double scale = 1.0 / sqrt(pivot);
            for (int v = block; v < last_vec; v++) row[v] *= scale;
            for (int i = l + 1; i < first + LANES && i < N; i++) {
                double factor = const_scalars(row)[i];
                for (int v = block; v < last_vec; v++) T[i * T_stride + v] -= factor * row[v];
            }
        }
    }
    return 1;
}

/* Form the tableau of an interval and factorize it,
 *
 *     T = L^-1 [A Z 1],   A = L L' = R + P_vv + b (P_vQ + P_Qv) + b^2 P_QQ,   Z = b P_Qq + P_vq.
 *
 * R (N,) is a diagonal. Returns 0 where A is not positive definite. */
static int eliminate_control(const ValueFunction *P, double b, const double *R, vec T[N][TABLEAU_VECS]) {
    for (int i = 0; i < N; i++) {
        for (int v = 0; v < NQ_VECS; v++) T[i][Z_VEC + v] = b * P->qq[i][v] + P->vq[i][v];
        for (int v = 0; v < N_VECS; v++) {
            T[i][v] = P->vv[i][v] + b * T[i][Z_VEC + v];
            T[i][IDENTITY_VEC + v] = (vec){0};
        }
        scalars(T[i])[i] += R[i];
        scalars(T[i])[IDENTITY_COLUMN + i] = 1.0;
    }
    for (int block = 0; block < N_VECS; block++)
        for (int other = block; other < N_VECS; other++) {
            vec P_Qv[LANES];
            transpose_block(P->vq[other * LANES] + block, NQ_VECS, P_Qv);
            for (int r = 0; r < LANES && block * LANES + r < N; r++) T[block * LANES + r][other] += b * P_Qv[r];
        }
    return factorize_tableau(T[0], TABLEAU_VECS, IDENTITY_VEC);
}

/* Form the gains of an interval from its tableau, and the value function at the node before it. By q,
 *
 *     P_qq <- P_qq - Z'A^-1 Z.
 *
 * The velocity v before the interval shifts Q by a v and adds R (w - v)^2 / 2, hence
 *
 *     P_vq = a P_Qq + R A^-1 Z,   P_vv = a (P_vQ + P_Qv - a P_QQ) + R - R A^-1 R.
 *
 * Symmetric matrices are computed in blocks on and to one side of the diagonal, and mirrored. */
static void update_value_function(const vec T[N][TABLEAU_VECS], double a, const double *R, ValueFunction *P,
                                  IntervalGains *to) {
    vec padded_gain[N_PADDED][NQ_VECS + N_VECS];
    vec padded_R[N_VECS];
    vec(*gain)[NQ_VECS + N_VECS] = N < N_PADDED ? padded_gain : to->gain;
    memset(gain, 0, sizeof padded_gain);
    memset(padded_R, 0, sizeof padded_R);
    memcpy(padded_R, R, N * sizeof(double));
    for (int block = 0; block < N_VECS; block++) {
        int first = block * LANES;
        gemm_block_row(T[0], TABLEAU_VECS, first, N, IDENTITY_COLUMN + first, Z_VEC, IDENTITY_VEC + block + 1, block,
                       gain[first], NQ_VECS + N_VECS);
        for (int other = 0; other < block; other++) {
            vec transposed[LANES];
            transpose_block(gain[first] + NQ_VECS + other, NQ_VECS + N_VECS, transposed);
            for (int r = 0; r < LANES; r++) gain[other * LANES + r][NQ_VECS + block] = transposed[r];
        }
    }
    if (N < N_PADDED) memcpy(to, gain, sizeof *to);
    for (int block = 0; block < NQ_VECS; block++) {
        int first = block * LANES;
        gemm_panel(T[0], TABLEAU_VECS, 0, N, Z_COLUMN + first, Z_VEC + block, IDENTITY_VEC, LANES,
                   P->qq[first] + block, NQ_VECS);
        for (int other = block + 1; other < NQ_VECS; other++) {
            vec transposed[LANES];
            transpose_block(P->qq[first] + other, NQ_VECS, transposed);
            for (int r = 0; r < LANES; r++) P->qq[other * LANES + r][block] = transposed[r];
        }
    }
    for (int i = 0; i < N; i++)
        for (int v = 0; v < NQ_VECS; v++) P->vq[i][v] = a * P->qq[i][v] - R[i] * gain[i][v];
    for (int block = 0; block < N_VECS; block++)
        for (int other = block; other < N_VECS; other++) {
            vec P_Qv[LANES];
            transpose_block(P->vq[other * LANES] + block, NQ_VECS, P_Qv);
            for (int r = 0; r < LANES && block * LANES + r < N; r++) {
                int i = block * LANES + r;
                P->vv[i][other] = a * (P->vq[i][other] + P_Qv[r] - a * P->qq[i][other]) +
                                  R[i] * padded_R[other] * gain[i][NQ_VECS + other];
            }
        }
    for (int i = 0; i < N; i++) scalars(P->vv[i])[i] += R[i];
}

/* Factorize the Newton equations from the last interval to the first.
 *
 * Out: the gains of the intervals (K,) and `schur` (S, S), the Hessian by the durations after all states are
 * eliminated, a Schur complement. Returns 0 where the Hessian by some control is not positive definite. */
NOINLINE int riccati_factorize(const RiccatiData *data, IntervalGains *intervals, double *schur) {
    const int64_t S = data->S;
    ValueFunction P;
    vec T[N][TABLEAU_VECS];
    int64_t rows_left = data->node_row_count;
    memset(&P, 0, sizeof P);
    for (int c = 0; c < S; c++)
        for (int e = 0; e < S; e++) scalars(P.qq[N + c])[N + e] = data->H_tau_tau[c * S + e];
    for (int64_t k = data->K - 1; k >= 0; k--) {
        double a = -data->gap_velocity[2 * k];
        double b = -data->gap_velocity[2 * k + 1];
        const double *R = data->R + k * N;
        add_node_cost(data, k, &rows_left, &P);
        substitute_durations(S, data->gap_tau + k * N * S, &P);
        if (!eliminate_control(&P, b, R, T)) return 0;
        update_value_function(T, a, R, &P, intervals + k);
    }
    for (int c = 0; c < S; c++)
        for (int e = 0; e < S; e++) schur[c * S + e] = const_scalars(P.qq[N + c])[N + e];
    return 1;
}

/* Begin the step of a backward sweep over interval k: add the gradient at the node after it, and compute
 *
 *     r = b p_Q + p_v,   p_tau += Gamma' p_Q.
 *
 * In and out: p_q (N + S,). In: p_v (N,). Out: r (N,), padded. */
INLINE void compute_control_gradient(const RiccatiData *data, int64_t k, const double *gradient, const double *p_v,
                                     double *p_q, double *r) {
    const int64_t S = data->S;
    double b = -data->gap_velocity[2 * k + 1];
    for (int i = 0; i < N; i++) p_q[i] += gradient[k * NX + i];
    for (int i = 0; i < N; i++) r[i] = b * p_q[i] + p_v[i] + gradient[k * NX + N + i];
    for (int i = N; i < N_PADDED; i++) r[i] = 0.0;
    for (int j = 0; j < N; j++)
        for (int c = 0; c < S; c++) p_q[N + c] -= data->gap_tau[(k * N + j) * S + c] * p_q[j];
}

/* Compute the gradient p = [p_q; p_v] of the value function, from the last interval to the first:
 *
 *     p += g_k+1,   r = b p_Q + p_v,   p_tau += Gamma' p_Q,
 *     p_q <- p_q - Z'A^-1 r,           p_v <- a p_Q + R A^-1 r.
 *
 * In: the gradient g at nodes 1 .. K (K, 2N), and in gradient_tau (S,) that by the durations.
 * Out: r, the derivatives by the controls (K, N), padded; gradient_tau after all states are eliminated. */
static void riccati_backward(const RiccatiData *data, const IntervalGains *intervals, const double *gradient,
                             double *gradient_tau, double *control_gradients) {
    const int64_t S = data->S;
    vec p[NQ_VECS + N_VECS];
    double *p_q = scalars(p);
    double *p_v = p_q + NQ_PADDED;
    memset(p, 0, sizeof p);
    for (int c = 0; c < S; c++) p_q[N + c] = gradient_tau[c];
    for (int64_t k = data->K - 1; k >= 0; k--) {
        double a = -data->gap_velocity[2 * k];
        double *r = control_gradients + k * N_PADDED;
        compute_control_gradient(data, k, gradient, p_v, p_q, r);
        memset(p_v, 0, N_PADDED * sizeof(double));
        for (int i = 0; i < N; i++)
            for (int j = 0; j < NQ_VECS + N_VECS; j++) p[j] += r[i] * intervals[k].gain[i][j];
        for (int i = 0; i < N; i++) p_v[i] = a * p_q[i] - data->R[k * N + i] * p_v[i];
    }
    for (int c = 0; c < S; c++) gradient_tau[c] = p_q[N + c];
}

/* Compute the steps of the states, from the first interval to the last: with q~ = [Q + a v; tau],
 *
 *     w = -A^-1 (Z q~ + r - R v),   Q+ = Q + a v + b w + Gamma tau,   v+ = w.
 *
 * In: steps tau of the durations (S,), r of the backward sweep (K, N), padded. Out: X, the steps of [Q; v] at nodes
 * 1 .. K, (K, 2N). */
static void riccati_forward(const RiccatiData *data, const IntervalGains *intervals, const double *tau,
                            const double *control_gradients, double *X) {
    const int64_t S = data->S;
    vec x[NQ_VECS + N_VECS]; /* [q~; r - R v], which the gains multiply */
    double *q = scalars(x);
    double *control_gradient = q + NQ_PADDED;
    double v[N] = {0};
    memset(x, 0, sizeof x);
    for (int c = 0; c < S; c++) q[N + c] = tau[c];
    for (int64_t k = 0; k < data->K; k++) {
        double a = -data->gap_velocity[2 * k];
        double b = -data->gap_velocity[2 * k + 1];
        for (int i = 0; i < N; i++) {
            q[i] += a * v[i];
            control_gradient[i] = control_gradients[k * N_PADDED + i] - data->R[k * N + i] * v[i];
        }
        for (int i = 0; i < N; i++) {
            vec sum = intervals[k].gain[i][0] * x[0];
            for (int j = 1; j < NQ_VECS + N_VECS; j++) sum += intervals[k].gain[i][j] * x[j];
            v[i] = sum_of_lanes(sum);
        }
        for (int i = 0; i < N; i++) {
            q[i] += b * v[i];
            for (int c = 0; c < S; c++) q[i] -= data->gap_tau[(k * N + i) * S + c] * tau[c];
        }
        memcpy(X + k * NX, q, N * sizeof(double));
        memcpy(X + k * NX + N, v, N * sizeof(double));
    }
}
