/* The Riccati recursion where constraints couple the states at both ends of an interval, such as those of forces.
 *
 * A row c of such a constraint adds weight c'c to the Hessian by [Q; v] at both ends and tau. By the dynamics of the
 * interval, Q+ = Q + a v + b w + Gamma tau, it is a row of y = [w; v; Q; tau] at its beginning,
 *
 *     y_w = c_v+ + b c_Q+,   y_v = c_v + a c_Q+,   y_Q = c_Q + c_Q+,   y_tau = c_tau + Gamma' c_Q+,
 *
 * so that the problem of an interval is min over w of 1/2 y'G y + r'w, with the value function P of the node after it,
 *
 *     G_ww = A + M_ww,              G_wv = a (b P_QQ + P_vQ) - R + M_wv,   G_wq = b P_Qq + P_vq + M_wq,
 *     G_vv = a^2 P_QQ + R + M_vv,   G_vq = a P_Qq + M_vq,                  G_qq = P_qq + M_qq,
 *
 * M being the sum of weight y y' over the rows. The velocity before the interval stands in all of it, so the columns of
 * v are eliminated too, which recursion.c need not do:
 *
 *     w = -G_ww^-1 (G_wv v + G_wq q + r),   P <- G - [G_vw; G_qw] G_ww^-1 [G_wv G_wq].
 *
 * Rows of the change of acceleration from the interval before depend on the velocity z where that began as well. Where a
 * kernel has such rows (HISTORY = N), z follows on Q and tau in q, and z+ = v. A row has y_z = c_z, and of P by z+ the
 * part by Q and tau is that by v before the interval,
 *
 *     G_wv += b P_Qz + P_vz,   G_vv += a (P_Qz + P_zQ) + P_zz,   G_vq += P_zq,
 *
 * while G has nothing by z but M.
 */

#define Y_V_COLUMN N_PADDED                                /* y = [w; v; q], each of them padded */
#define Y_Q_COLUMN (2 * N_PADDED)
#define Y_PADDED (2 * N_PADDED + NQ_PADDED)
#define Y_V_VEC N_VECS
#define Y_Q_VEC (2 * N_VECS)
#define Y_VECS (2 * N_VECS + NQ_VECS)
#define DENSE_TABLEAU_VECS (Y_VECS + N_VECS)               /* [G_ww G_wv G_wq 1] */
#define INTERVAL_ROW (2 * NX + S + HISTORY)                /* entries of a row by both states, tau and z */
#define Y_Z_COLUMN (Y_Q_COLUMN + HISTORY_COLUMN)           /* of z in y */

/* Constraints on intervals: which, their derivatives c by [Q; v] at both ends, and their weights as one row, of which
 * the part by tau is not c but `by_tau`, and what is left of the weights of the durations. */
typedef struct {
    int64_t count;             /* I */
    const int64_t *interval;   /* ascending, (I,) */
    const double *jacobian;    /* (I, 4N + S + HISTORY) */
    const double *weights;     /* (I,) */
    const double *by_tau;      /* (I, S) */
} IntervalRows;

/* The feedback law of an interval, rows of the gains [-G_ww^-1 G_wv, -G_ww^-1 G_wq, -G_ww^-1]. */
typedef struct {
    vec gain[N][Y_VECS];
} DenseGains;

/* Write a row of an interval as one of y; `gap_tau` is -Gamma (N, S). */
static void reduce_interval_row(int64_t S, const double *c, const double *by_tau, double a, double b, const double *gap_tau,
                                vec y_row[Y_VECS]) {
    const double *by_Q = c;
    const double *by_v = c + N;
    const double *by_next_Q = c + NX;
    const double *by_next_v = c + NX + N;
    double *y = scalars(y_row);
    memset(y_row, 0, Y_VECS * sizeof(vec));
    for (int i = 0; i < N; i++) {
        y[i] = by_next_v[i] + b * by_next_Q[i];
        y[Y_V_COLUMN + i] = by_v[i] + a * by_next_Q[i];
        y[Y_Q_COLUMN + i] = by_Q[i] + by_next_Q[i];
    }
    for (int e = 0; e < S; e++) {
        double sum = by_tau[e];
        for (int i = 0; i < N; i++) sum -= gap_tau[i * S + e] * by_next_Q[i];
        y[Y_Q_COLUMN + N + e] = sum;
    }
    for (int i = 0; i < HISTORY; i++) y[Y_Z_COLUMN + i] = c[2 * NX + S + i];
}

/* Turn what G has by z+ into what it has by v: z+ = v. */
static void substitute_history(const ValueFunction *P, double a, vec G[Y_PADDED][Y_VECS]) {
    for (int i = 0; i < N; i++) {
        double *by_w = scalars(G[i]);
        double *by_v = scalars(G[Y_V_COLUMN + i]);
        const double *P_z = const_scalars(P->qq[HISTORY_COLUMN + i]);
        for (int j = 0; j < HISTORY; j++) {
            by_w[Y_V_COLUMN + j] += by_w[Y_Z_COLUMN + j];
            by_v[Y_V_COLUMN + j] += by_v[Y_Z_COLUMN + j] + a * P_z[j] + P_z[HISTORY_COLUMN + j];
            by_w[Y_Z_COLUMN + j] = 0.0;
            by_v[Y_Z_COLUMN + j] = 0.0;
        }
        for (int j = 0; j < HISTORY_COLUMN; j++) by_v[Y_Q_COLUMN + j] += P_z[j];
    }
    for (int i = 0; i < HISTORY_COLUMN; i++)
        for (int j = 0; j < HISTORY; j++) scalars(G[Y_Q_COLUMN + i])[Y_Z_COLUMN + j] = 0.0;
}

/* Form the blocks of G on and above the diagonal, but for M. */
static void form_interval_hessian(int64_t S, const ValueFunction *P, double a, double b, const double *R, vec G[Y_PADDED][Y_VECS]) {
    memset(G, 0, Y_PADDED * Y_VECS * sizeof(vec));
    for (int i = 0; i < N; i++) {
        for (int v = 0; v < NQ_VECS; v++) {
            G[i][Y_Q_VEC + v] = b * P->qq[i][v] + P->vq[i][v];
            G[Y_V_COLUMN + i][Y_Q_VEC + v] = a * P->qq[i][v];
        }
        for (int v = 0; v < N_VECS; v++) {
            G[i][v] = P->vv[i][v] + b * G[i][Y_Q_VEC + v];
            G[i][Y_V_VEC + v] = a * G[i][Y_Q_VEC + v];
            G[Y_V_COLUMN + i][Y_V_VEC + v] = a * G[Y_V_COLUMN + i][Y_Q_VEC + v];
        }
    }
    for (int block = 0; block < N_VECS; block++)
        for (int other = block; other < N_VECS; other++) {
            vec P_Qv[LANES];
            transpose_block(P->vq[other * LANES] + block, NQ_VECS, P_Qv);
            for (int r = 0; r < LANES && block * LANES + r < N; r++) G[block * LANES + r][other] += b * P_Qv[r];
        }
    for (int i = 0; i < N; i++) {
        scalars(G[i])[i] += R[i];
        scalars(G[i])[Y_V_COLUMN + i] -= R[i];
        scalars(G[Y_V_COLUMN + i])[Y_V_COLUMN + i] += R[i];
    }
    for (int i = 0; i < N + S; i++)
        for (int v = 0; v < NQ_VECS; v++) G[Y_Q_COLUMN + i][Y_Q_VEC + v] = P->qq[i][v];
    if (HISTORY) substitute_history(P, a, G);
}

#define ROW_BATCH 64 /* rows that are added together */

/* Add weight y y' of at most ROW_BATCH rows y to the blocks of G on and above the diagonal, rows in groups of LANES
 * columns, so that each row of G is read and written once. Rows of the change of an acceleration have few entries: those
 * that have none in a row of G are left out there. */
static void add_row_batch(const vec (*rows)[Y_VECS], const double *weights, int count, vec G[Y_PADDED][Y_VECS]) {
    double factors[ROW_BATCH];
    int chosen[ROW_BATCH];
    for (int i = 0; i < Y_PADDED; i++) {
        int first_vec = i / LANES;
        int chosen_count = 0;
        for (int r = 0; r < count; r++) {
            double factor = weights[r] * const_scalars(rows[r])[i];
            factors[chosen_count] = factor;
            chosen[chosen_count] = r;
            chosen_count += factor != 0.0;
        }
        for (int v = first_vec; v < Y_VECS && chosen_count; v += 3) {
            int vecs = Y_VECS - v < 3 ? Y_VECS - v : 3;
            vec sum[3];
            for (int j = 0; j < vecs; j++) sum[j] = G[i][v + j];
            for (int r = 0; r < chosen_count; r++)
                for (int j = 0; j < vecs; j++) sum[j] += factors[r] * rows[chosen[r]][v + j];
            for (int j = 0; j < vecs; j++) G[i][v + j] = sum[j];
        }
    }
}

/* Add weight y y' of `count` rows y to the blocks of G on and above the diagonal. */
static void add_interval_rows(const vec (*rows)[Y_VECS], const double *weights, int count, vec G[Y_PADDED][Y_VECS]) {
    for (int first = 0; first < count; first += ROW_BATCH) {
        int batch = count - first < ROW_BATCH ? count - first : ROW_BATCH;
        add_row_batch(rows + first, weights + first, batch, G);
    }
}

/* Factorize G_ww and form the gains of an interval and the value function at the node before it, see above. Returns 0
 * where G_ww is not positive definite. */
static int eliminate_dense(const vec G[Y_PADDED][Y_VECS], vec T[N][DENSE_TABLEAU_VECS], ValueFunction *P,
                           DenseGains *to) {
    for (int i = 0; i < N; i++) {
        memcpy(T[i], G[i], Y_VECS * sizeof(vec));
        for (int v = 0; v < N_VECS; v++) T[i][Y_VECS + v] = (vec){0};
        scalars(T[i])[Y_PADDED + i] = 1.0;
    }
    if (!factorize_tableau(T[0], DENSE_TABLEAU_VECS, Y_VECS)) return 0;
    vec gain[N_PADDED][Y_VECS];
    memset(gain, 0, sizeof gain);
    for (int block = 0; block < N_VECS; block++) {
        int first = block * LANES;
        gemm_block_row(T[0], DENSE_TABLEAU_VECS, first, N, Y_PADDED + first, Y_V_VEC, Y_VECS + block + 1, block,
                       gain[first], Y_VECS);
        for (int other = 0; other < block; other++) {
            vec transposed[LANES];
            transpose_block(gain[first] + N_VECS + NQ_VECS + other, Y_VECS, transposed);
            for (int r = 0; r < LANES; r++) gain[other * LANES + r][N_VECS + NQ_VECS + block] = transposed[r];
        }
    }
    memcpy(to, gain, sizeof *to);
    memset(P, 0, sizeof *P);
    for (int block = 0; block < N_VECS; block++) {
        int first = block * LANES;
        for (int r = 0; r < LANES && first + r < N; r++) {
            memcpy(P->vv[first + r] + block, G[Y_V_COLUMN + first + r] + Y_V_VEC + block,
                   (N_VECS - block) * sizeof(vec));
            memcpy(P->vq[first + r], G[Y_V_COLUMN + first + r] + Y_Q_VEC, NQ_VECS * sizeof(vec));
        }
        gemm_block_row(T[0], DENSE_TABLEAU_VECS, 0, N, Y_V_COLUMN + first, Y_V_VEC + block, Y_Q_VEC, block,
                       P->vv[first] + block, N_VECS);
        gemm_block_row(T[0], DENSE_TABLEAU_VECS, 0, N, Y_V_COLUMN + first, Y_Q_VEC, Y_VECS, block, P->vq[first],
                       NQ_VECS);
    }
    for (int block = 0; block < NQ_VECS; block++) {
        int first = block * LANES;
        for (int r = 0; r < LANES; r++)
            memcpy(P->qq[first + r] + block, G[Y_Q_COLUMN + first + r] + Y_Q_VEC + block,
                   (NQ_VECS - block) * sizeof(vec));
        gemm_panel(T[0], DENSE_TABLEAU_VECS, 0, N, Y_Q_COLUMN + first, Y_Q_VEC + block, Y_VECS, LANES,
                   P->qq[first] + block, NQ_VECS);
        for (int other = block + 1; other < NQ_VECS; other++) {
            vec transposed[LANES];
            transpose_block(P->qq[first] + other, NQ_VECS, transposed);
            for (int r = 0; r < LANES; r++) P->qq[other * LANES + r][block] = transposed[r];
        }
    }
    return 1;
}

/* Factorize the Newton equations from the last interval to the first, as `riccati_factorize` does. `rows` has room for
 * the rows of one interval. */
NOINLINE int dense_factorize(const RiccatiData *data, const IntervalRows *interval_rows, vec (*rows)[Y_VECS],
                             DenseGains *intervals, double *schur) {
    const int64_t S = data->S;
    ValueFunction P;
    vec G[Y_PADDED][Y_VECS];
    vec T[N][DENSE_TABLEAU_VECS];
    int64_t node_rows_left = data->node_row_count;
    int64_t last = interval_rows->count;
    memset(&P, 0, sizeof P);
    for (int c = 0; c < S; c++)
        for (int e = 0; e < S; e++) scalars(P.qq[N + c])[N + e] = data->H_tau_tau[c * S + e];
    for (int64_t k = data->K - 1; k >= 0; k--) {
        double a = -data->gap_velocity[2 * k];
        double b = -data->gap_velocity[2 * k + 1];
        const double *gap_tau = data->gap_tau + k * N * S;
        int64_t first = last;
        add_node_cost(data, k, &node_rows_left, &P);
        substitute_durations(S, gap_tau, &P);
        form_interval_hessian(S, &P, a, b, data->R + k * N, G);
        while (first > 0 && interval_rows->interval[first - 1] == k) first--;
        for (int64_t i = first; i < last; i++)
            reduce_interval_row(S, interval_rows->jacobian + i * INTERVAL_ROW, interval_rows->by_tau + i * S, a, b, gap_tau,
                                rows[i - first]);
        add_interval_rows(rows, interval_rows->weights + first, (int)(last - first), G);
        last = first;
        if (!eliminate_dense(G, T, &P, intervals + k)) return 0;
    }
    for (int c = 0; c < S; c++)
        for (int e = 0; e < S; e++) schur[c * S + e] = const_scalars(P.qq[N + c])[N + e];
    return 1;
}

/* Compute the gradient of the value function from the last interval to the first, as `riccati_backward` does:
 *
 *     p += g_k+1,   r = b p_Q + p_v,   p_tau += Gamma' p_Q,
 *     p_q <- p_q - G_qw G_ww^-1 r,     p_v <- a p_Q + p_z - G_vw G_ww^-1 r,   with 0 for p_z after that in p_q. */
static void dense_backward(const RiccatiData *data, const DenseGains *intervals, const double *gradient,
                           double *gradient_tau, double *control_gradients) {
    const int64_t S = data->S;
    vec p[N_VECS + NQ_VECS];
    double *p_v = scalars(p);
    double *p_q = p_v + N_PADDED;
    memset(p, 0, sizeof p);
    for (int c = 0; c < S; c++) p_q[N + c] = gradient_tau[c];
    for (int64_t k = data->K - 1; k >= 0; k--) {
        double a = -data->gap_velocity[2 * k];
        double *r = control_gradients + k * N_PADDED;
        compute_control_gradient(data, k, gradient, p_v, p_q, r);
        for (int i = 0; i < N; i++) p_v[i] = a * p_q[i];
        for (int i = 0; i < HISTORY; i++) {
            p_v[i] += p_q[HISTORY_COLUMN + i];
            p_q[HISTORY_COLUMN + i] = 0.0;
        }
        for (int i = 0; i < N; i++)
            for (int j = 0; j < N_VECS + NQ_VECS; j++) p[j] += r[i] * intervals[k].gain[i][j];
    }
    for (int c = 0; c < S; c++) gradient_tau[c] = p_q[N + c];
}

/* Compute the steps of the states from the first interval to the last, as `riccati_forward` does, with the gains of v:
 *
 *     w = -G_ww^-1 (G_wv v + G_wq q + r). */
static void dense_forward(const RiccatiData *data, const DenseGains *intervals, const double *tau,
                          const double *control_gradients, double *X) {
    const int64_t S = data->S;
    vec x[Y_VECS]; /* [v; q; r], which the gains multiply */
    double *v = scalars(x);
    double *q = v + N_PADDED;
    double *r = q + NQ_PADDED;
    memset(x, 0, sizeof x);
    for (int c = 0; c < S; c++) q[N + c] = tau[c];
    for (int64_t k = 0; k < data->K; k++) {
        double a = -data->gap_velocity[2 * k];
        double b = -data->gap_velocity[2 * k + 1];
        double w[N];
        memcpy(r, control_gradients + k * N_PADDED, N * sizeof(double));
        for (int i = 0; i < N; i++) {
            vec sum = intervals[k].gain[i][0] * x[0];
            for (int j = 1; j < Y_VECS; j++) sum += intervals[k].gain[i][j] * x[j];
            w[i] = (sum[0] + sum[1]) + (sum[2] + sum[3]);
        }
        for (int i = 0; i < N; i++) {
            q[i] += a * v[i] + b * w[i];
            for (int c = 0; c < S; c++) q[i] -= data->gap_tau[(k * N + i) * S + c] * tau[c];
            if (HISTORY) q[HISTORY_COLUMN + i] = v[i];
            v[i] = w[i];
        }
        memcpy(X + k * NX, q, N * sizeof(double));
        memcpy(X + k * NX + N, v, N * sizeof(double));
    }
}
