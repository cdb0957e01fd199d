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
 * Gains of the feedback law are not formed: each factorization serves two solves, which take less with its factors.
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

#define FEW_ENTRIES 8 /* most entries of a row that are added one by one */

/* Where a row of y may differ from 0. */
typedef struct {
    uint64_t blocks;               /* bit b: in the columns of vector b */
    int64_t count;                 /* of its entries, FEW_ENTRIES + 1 where it has more than FEW_ENTRIES */
    int64_t columns[FEW_ENTRIES];  /* of the entries, ascending */
} Pattern;

/* Constraints on intervals: which, as rows of y, and their weights. Of the derivatives by tau a row has those of its
 * common bound, see `form_interval_rows`, which change from one iteration to the next. */
typedef struct {
    int64_t count;             /* I */
    const int64_t *interval;   /* ascending, (I,) */
    const double *weights;     /* (I,) */
    const vec (*y)[Y_VECS];    /* (I, Y_VECS) */
    const Pattern *patterns;   /* (I,) */
} IntervalRows;

/* The tableau of an interval, L^-1 [. G_wv G_wq 1] with G_ww = L L', from which its feedback law follows. */
typedef struct {
    vec row[N][DENSE_TABLEAU_VECS];
} DenseTableau;

/* Write a row c of an interval as one of y, but for c_tau; `gap_tau` is -Gamma (N, S). */
static void reduce_interval_row(int64_t S, const double *c, double a, double b, const double *gap_tau, vec y_row[Y_VECS]) {
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
    for (int e = 0; e < S; e++)
        for (int i = 0; i < N; i++) y[Y_Q_COLUMN + N + e] -= gap_tau[i * S + e] * by_next_Q[i];
    for (int i = 0; i < HISTORY; i++) y[Y_Z_COLUMN + i] = c[2 * NX + S + i];
}

/* Return where a row of y may differ from 0, by tau everywhere. */
static Pattern pattern_of(int64_t S, const vec y_row[Y_VECS]) {
    const double *y = const_scalars(y_row);
    Pattern pattern = {0};
    for (int i = 0; i < Y_PADDED; i++) {
        int is_by_tau = i >= Y_Q_COLUMN + N && i < Y_Q_COLUMN + N + S;
        if (y[i] == 0.0 && !is_by_tau) continue;
        pattern.blocks |= (uint64_t)1 << i / LANES;
        if (pattern.count < FEW_ENTRIES) pattern.columns[pattern.count] = i;
        if (pattern.count <= FEW_ENTRIES) pattern.count++;
    }
    return pattern;
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
    if (N < N_PADDED) {
        memset(G[N], 0, (N_PADDED - N) * sizeof *G);
        memset(G[Y_V_COLUMN + N], 0, (N_PADDED - N) * sizeof *G);
    }
    memset(G[Y_Q_COLUMN + N + S], 0, (NQ_PADDED - N - S) * sizeof *G);
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

/* Add weight y y' of a row with few entries to the blocks of G on and above the diagonal. */
static void add_few_entries(const Pattern *pattern, double weight, const vec y_row[Y_VECS], vec G[Y_PADDED][Y_VECS]) {
    const double *y = const_scalars(y_row);
    for (int64_t l = 0; l < pattern->count; l++) {
        int64_t i = pattern->columns[l];
        double factor = weight * y[i];
        for (int64_t m = 0; m < pattern->count; m++) {
            int64_t j = pattern->columns[m];
            if (j / LANES >= i / LANES) scalars(G[i])[j] += factor * y[j];
        }
    }
}

/* Add the sum of factors_r y' over some rows y to `vecs` vectors of LANES rows of G, few enough to stay in registers. */
INLINE void add_products(const vec *factors, const vec *const *rows, int count, int first_vec, int vecs,
                         vec (*G)[Y_VECS]) {
    vec sum[LANES][3];
    for (int r = 0; r < LANES; r++)
        for (int j = 0; j < vecs; j++) sum[r][j] = G[r][first_vec + j];
    for (int l = 0; l < count; l++)
        for (int r = 0; r < LANES; r++)
            for (int j = 0; j < vecs; j++) sum[r][j] += const_scalars(factors + l)[r] * rows[l][first_vec + j];
    for (int r = 0; r < LANES; r++)
        for (int j = 0; j < vecs; j++) G[r][first_vec + j] = sum[r][j];
}

/* Add weight y y' of at most ROW_BATCH rows to the blocks of G on and above the diagonal, LANES rows of G at a time. */
static void add_row_batch(const IntervalRows *rows, const int64_t *batch, int count, vec G[Y_PADDED][Y_VECS]) {
    vec factors[ROW_BATCH];
    const vec *chosen[ROW_BATCH];
    for (int block = 0; block < Y_VECS; block++) {
        int chosen_count = 0;
        for (int l = 0; l < count; l++) {
            int64_t i = batch[l];
            if (!(rows->patterns[i].blocks >> block & 1)) continue;
            factors[chosen_count] = rows->weights[i] * rows->y[i][block];
            chosen[chosen_count] = rows->y[i];
            chosen_count++;
        }
        vec(*to)[Y_VECS] = G + block * LANES;
        int v = block;
        if (chosen_count == 0) continue;
        for (; v + 2 < Y_VECS; v += 3) add_products(factors, chosen, chosen_count, v, 3, to);
        if (v + 1 < Y_VECS) add_products(factors, chosen, chosen_count, v, 2, to);
        else if (v < Y_VECS) add_products(factors, chosen, chosen_count, v, 1, to);
    }
}

/* Add weight y y' of the rows from `first` to before `last` to the blocks of G on and above the diagonal. */
static void add_interval_rows(const IntervalRows *rows, int64_t first, int64_t last, vec G[Y_PADDED][Y_VECS]) {
    int64_t batch[ROW_BATCH];
    int count = 0;
    for (int64_t i = first; i < last; i++) {
        if (rows->patterns[i].count <= FEW_ENTRIES) add_few_entries(rows->patterns + i, rows->weights[i], rows->y[i], G);
        else batch[count++] = i;
        if (count < ROW_BATCH && i < last - 1) continue;
        add_row_batch(rows, batch, count, G);
        count = 0;
    }
}

/* Form the tableau of an interval, factorize G_ww, and form the value function at the node before it, see above. Returns
 * 0 where G_ww is not positive definite. */
static int eliminate_dense(const vec G[Y_PADDED][Y_VECS], DenseTableau *tableau, ValueFunction *P) {
    vec(*T)[DENSE_TABLEAU_VECS] = tableau->row;
    for (int i = 0; i < N; i++) {
        for (int v = 0; v < Y_VECS; v++) T[i][v] = G[i][v];
        for (int v = 0; v < N_VECS; v++) T[i][Y_VECS + v] = (vec){0};
        scalars(T[i])[Y_PADDED + i] = 1.0;
    }
    if (!factorize_tableau(T[0], DENSE_TABLEAU_VECS, Y_VECS)) return 0;
    for (int block = 0; block < N_VECS; block++) {
        int first = block * LANES;
        for (int r = 0; r < LANES && first + r < N; r++) {
            for (int v = block; v < N_VECS; v++) P->vv[first + r][v] = G[Y_V_COLUMN + first + r][Y_V_VEC + v];
            for (int v = 0; v < NQ_VECS; v++) P->vq[first + r][v] = G[Y_V_COLUMN + first + r][Y_Q_VEC + v];
        }
        gemm_block_row(T[0], DENSE_TABLEAU_VECS, 0, N, Y_V_COLUMN + first, Y_V_VEC + block, Y_Q_VEC, block,
                       P->vv[first] + block, N_VECS);
        gemm_block_row(T[0], DENSE_TABLEAU_VECS, 0, N, Y_V_COLUMN + first, Y_Q_VEC, Y_VECS, block, P->vq[first],
                       NQ_VECS);
    }
    for (int block = 0; block < NQ_VECS; block++) {
        int first = block * LANES;
        for (int r = 0; r < LANES; r++)
            for (int v = block; v < NQ_VECS; v++) P->qq[first + r][v] = G[Y_Q_COLUMN + first + r][Y_Q_VEC + v];
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

/* Factorize the Newton equations from the last interval to the first, as `riccati_factorize` does. */
NOINLINE int dense_factorize(const RiccatiData *data, const IntervalRows *rows, DenseTableau *tableaux, double *schur) {
    const int64_t S = data->S;
    ValueFunction P;
    vec G[Y_PADDED][Y_VECS];
    int64_t node_rows_left = data->node_row_count;
    int64_t last = rows->count;
    memset(&P, 0, sizeof P);
    for (int c = 0; c < S; c++)
        for (int e = 0; e < S; e++) scalars(P.qq[N + c])[N + e] = data->H_tau_tau[c * S + e];
    for (int64_t k = data->K - 1; k >= 0; k--) {
        double a = -data->gap_velocity[2 * k];
        double b = -data->gap_velocity[2 * k + 1];
        int64_t first = last;
        add_node_cost(data, k, &node_rows_left, &P);
        substitute_durations(S, data->gap_tau + k * N * S, &P);
        form_interval_hessian(S, &P, a, b, data->R + k * N, G);
        while (first > 0 && rows->interval[first - 1] == k) first--;
        add_interval_rows(rows, first, last, G);
        last = first;
        if (!eliminate_dense(G, tableaux + k, &P)) return 0;
    }
    for (int c = 0; c < S; c++)
        for (int e = 0; e < S; e++) schur[c * S + e] = const_scalars(P.qq[N + c])[N + e];
    return 1;
}

/* Compute the gradient of the value function from the last interval to the first, as `riccati_backward` does, with the
 * tableau T = L^-1 [. G_wv G_wq 1]:
 *
 *     p += g_k+1,   r = b p_Q + p_v,   p_tau += Gamma' p_Q,   s = L^-1 r,
 *     p_q <- p_q - T_q's,   p_v <- a p_Q + p_z - T_v's,   with 0 for p_z after that in p_q.
 *
 * Out: control_gradients, s of each interval, (K, N), padded. */
static void dense_backward(const RiccatiData *data, const DenseTableau *tableaux, const double *gradient,
                           double *gradient_tau, double *control_gradients) {
    const int64_t S = data->S;
    vec p[N_VECS + NQ_VECS];
    vec r[N_VECS];
    double *p_v = scalars(p);
    double *p_q = p_v + N_PADDED;
    memset(p, 0, sizeof p);
    memset(r, 0, sizeof r);
    for (int c = 0; c < S; c++) p_q[N + c] = gradient_tau[c];
    for (int64_t k = data->K - 1; k >= 0; k--) {
        double a = -data->gap_velocity[2 * k];
        double *s = control_gradients + k * N_PADDED;
        compute_control_gradient(data, k, gradient, p_v, p_q, scalars(r));
        for (int i = 0; i < N; i++) p_v[i] = a * p_q[i];
        for (int i = 0; i < HISTORY; i++) {
            p_v[i] += p_q[HISTORY_COLUMN + i];
            p_q[HISTORY_COLUMN + i] = 0.0;
        }
        for (int i = 0; i < N; i++) {
            const vec *T = tableaux[k].row[i];
            vec sum = T[Y_VECS] * r[0];
            for (int j = 1; j < N_VECS; j++) sum += T[Y_VECS + j] * r[j];
            s[i] = sum_of_lanes(sum);
            for (int j = 0; j < N_VECS + NQ_VECS; j++) p[j] -= s[i] * T[Y_V_VEC + j];
        }
    }
    for (int c = 0; c < S; c++) gradient_tau[c] = p_q[N + c];
}

/* Compute the steps of the states from the first interval to the last, as `riccati_forward` does:
 *
 *     w = -L^-T (T_v v + T_q q + s). */
static void dense_forward(const RiccatiData *data, const DenseTableau *tableaux, const double *tau,
                          const double *control_gradients, double *X) {
    const int64_t S = data->S;
    vec x[N_VECS + NQ_VECS]; /* [v; q] */
    double *v = scalars(x);
    double *q = v + N_PADDED;
    memset(x, 0, sizeof x);
    for (int c = 0; c < S; c++) q[N + c] = tau[c];
    for (int64_t k = 0; k < data->K; k++) {
        double a = -data->gap_velocity[2 * k];
        double b = -data->gap_velocity[2 * k + 1];
        const double *s = control_gradients + k * N_PADDED;
        vec w[N_VECS];
        memset(w, 0, sizeof w);
        for (int i = 0; i < N; i++) {
            const vec *T = tableaux[k].row[i];
            vec sum = T[Y_V_VEC] * x[0];
            for (int j = 1; j < N_VECS + NQ_VECS; j++) sum += T[Y_V_VEC + j] * x[j];
            double factor = sum_of_lanes(sum) + s[i];
            for (int j = 0; j < N_VECS; j++) w[j] -= factor * T[Y_VECS + j];
        }
        for (int i = 0; i < N; i++) {
            double w_i = scalars(w)[i];
            q[i] += a * v[i] + b * w_i;
            for (int c = 0; c < S; c++) q[i] -= data->gap_tau[(k * N + i) * S + c] * tau[c];
            if (HISTORY) q[HISTORY_COLUMN + i] = v[i];
            v[i] = w_i;
        }
        memcpy(X + k * NX, q, N * sizeof(double));
        memcpy(X + k * NX + N, v, N * sizeof(double));
    }
}
