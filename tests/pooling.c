/*  pooling.c - edge-contraction pooling against brute force

    shows   scores against double precision; the greedy contraction and the coarse graph against a search that knows
            nothing of sorting, on random graphs with ties, fans, lone nodes and scores that are no numbers; gather and
            scatter against their formulas
    build   cc -O2 pooling.c -o pooling -lm */
#define DEFORMNET_IMPLEMENTATION
#define DEFORMNET_STATIC
#include "../deformnet.h"
#include "test.h"
#include <math.h>

static size_t pick(uint64_t *seed, size_t low, size_t high) { return low + test_random(seed) % (high - low + 1); }
static float *random_floats(uint64_t *seed, size_t count, float size)
{
   float *p = (float *)test_block(count * sizeof(float));
   size_t i;
   for (i = 0; i < count; i++) p[i] = test_uniform(seed, -size, size);
   return p;
}
static float from_bits(uint32_t u)
{
   float x;
   memcpy(&x, &u, 4);
   return x;
}
static int is_nan(float x) /* by its bits, as test_finite */
{
   uint32_t u;
   memcpy(&u, &x, 4);
   return (u & 0x7fffffffu) > 0x7f800000u;
}
static int close_to(double a, double b) { return fabs(a - b) <= 1e-5 + 1e-4 * fabs(b); }

/* --- graphs and room for their clusters, each array of exactly its documented capacity */
typedef struct meshy {
   dn_graph g;
   size_t edges; /* directed */
   uint32_t *first, *next;
   dn_clusters c;
   void *scratch;
} meshy;
static meshy meshy_of(const unsigned char *joined, size_t nodes)
{
   meshy m;
   size_t i, j;
   m.edges = 0;
   for (i = 0; i < nodes * nodes; i++) m.edges += joined[i];
   m.first = (uint32_t *)test_block((nodes + 1) * 4);
   m.next = (uint32_t *)test_block(m.edges * 4);
   for (i = m.edges = 0; i < nodes; i++) {
      m.first[i] = (uint32_t)m.edges;
      for (j = 0; j < nodes; j++)
         if (joined[i * nodes + j]) m.next[m.edges++] = (uint32_t)j;
   }
   m.first[nodes] = (uint32_t)m.edges;
   m.g.nodes = nodes, m.g.first = m.first, m.g.next = m.next;
   m.c.members = (uint32_t *)test_block(nodes * 8);
   m.c.score = (float *)test_block(nodes * 4);
   m.c.cluster = (uint32_t *)test_block(nodes * 4);
   m.c.coarse_first = (uint32_t *)test_block((nodes + 1) * 4);
   m.c.coarse_next = (uint32_t *)test_block(m.edges * 4);
   m.scratch = test_aligned(dn_pool_scratch(nodes, m.edges));
   return m;
}
enum { SPARSE, FANS, FINS, LONERS, KINDS };
static meshy random_meshy(uint64_t *seed, size_t nodes, int kind)
{
   unsigned char *joined = (unsigned char *)test_block(nodes * nodes);
   size_t i, a, b;
   meshy m;
   memset(joined, 0, nodes * nodes);
   for (i = 0; i < nodes * 2; i++) {
      a = pick(seed, 0, nodes - 1), b = pick(seed, 0, nodes - 1);
      if (kind == FANS) a = pick(seed, 0, nodes - 1) % 3;                        /* hubs 0, 1, 2 */
      if (kind == FINS) b = a + 1 + pick(seed, 0, 1), b = b < nodes ? b : a;     /* a strip of triangles */
      if (kind == LONERS && (a % 3 != 1 || b % 3 != 1)) continue;
      if (a != b) joined[a * nodes + b] = joined[b * nodes + a] = 1;
   }
   m = meshy_of(joined, nodes);
   free(joined);
   return m;
}
static void meshy_free(meshy *m)
{
   free(m->first), free(m->next);
   free(m->c.members), free(m->c.score), free(m->c.cluster), free(m->c.coarse_first), free(m->c.coarse_next);
   test_aligned_free(m->scratch);
}

/* --- the contraction by search: again and again the best edge whose ends are both free */
static int better(float a, float b) /* numbers fall, NaN last; equal ones are decided by the order of the search */
{
   return is_nan(b) ? !is_nan(a) : a > b;
}
static size_t search(const meshy *m, const float *scores, uint32_t *partner, float *score) /* (N) of both; pairs */
{
   size_t i, e, pairs = 0;
   for (i = 0; i < m->g.nodes; i++) partner[i] = UINT32_MAX, score[i] = 1;
   for (;;) {
      size_t bi = 0, be = SIZE_MAX;
      uint32_t j;
      for (i = 0; i < m->g.nodes; i++)
         for (e = m->first[i]; partner[i] == UINT32_MAX && e < m->first[i + 1]; e++)
            if (partner[m->next[e]] == UINT32_MAX && (be == SIZE_MAX || better(scores[e], scores[be]))) bi = i, be = e;
      if (be == SIZE_MAX) return pairs;
      j = m->next[be];
      partner[bi] = j | 0x80000000u; /* the one the chosen edge starts from */
      partner[j] = (uint32_t)bi;
      score[bi] = score[j] = scores[be];
      pairs++;
   }
}
static int same_number(float a, float b) { return memcmp(&a, &b, 4) == 0 || a == b; }
static void check_clusters(const meshy *m, const float *scores, const char *which)
{
   size_t N = m->g.nodes, pairs, i, n, k, at = 0, bad = 0, e;
   uint32_t *partner = (uint32_t *)test_block(N * 4);
   float *score = (float *)test_block(N * 4);
   const dn_clusters *c = &m->c;
   pairs = search(m, scores, partner, score);
   CHECK_MSG(c->count == N - pairs, "%s: %lu clusters, not %lu", which, (unsigned long)c->count,
             (unsigned long)(N - pairs));
   if (c->count == N - pairs) {
      for (i = 0; i < N; i++) { /* numbered by the smaller member */
         uint32_t other = partner[i] == UINT32_MAX ? (uint32_t)i : partner[i] & 0x7fffffffu;
         int starts = partner[i] == UINT32_MAX || (partner[i] & 0x80000000u);
         if (other < i) continue;
         bad += c->members[2 * at] != (starts ? i : other) || c->members[2 * at + 1] != (starts ? other : i);
         bad += !same_number(c->score[at], score[i]) || c->cluster[i] != at || c->cluster[other] != at;
         at++;
      }
      CHECK_MSG(bad == 0 && at == c->count, "%s: %lu clusters differ", which, (unsigned long)bad);
      at = 0;
      for (i = 0; i < c->count; i++) { /* an edge wherever any edge joins the members */
         bad += c->coarse_first[i] != at;
         for (n = 0; n < c->count; n++) {
            int joined = 0;
            for (k = 0; k < 2; k++)
               for (e = m->first[c->members[2 * i + k]]; e < m->first[c->members[2 * i + k] + 1]; e++)
                  joined |= n != i && c->cluster[m->next[e]] == n;
            if (joined) bad += at >= m->edges || c->coarse_next[at] != n, at++;
         }
      }
      CHECK_MSG(bad == 0 && c->coarse_first[c->count] == at, "%s: the coarse graph differs", which);
      CHECK(c->graph.nodes == c->count && c->graph.first == c->coarse_first && c->graph.next == c->coarse_next);
   }
   free(partner), free(score);
}
TEST(contraction_is_the_greedy_one)
{
   uint64_t seed = 17;
   size_t n, e, cases = 0;
   int kind, ties;
   for (kind = 0; kind < KINDS; kind++)
      for (ties = 0; ties < 4; ties++)
         for (n = 1; n <= 34; n += 3, cases++) {
            meshy m = random_meshy(&seed, n, kind);
            float *scores = random_floats(&seed, m.edges, 1);
            for (e = 0; e < m.edges; e++) {
               scores[e] = scores[e] * 0.5f + 0.5f;
               if (ties == 1) scores[e] = (float)(int)(scores[e] * 4) * 0.25f; /* many equal ones */
               if (ties == 2 && pick(&seed, 0, 2) == 0) { /* NaN and infinity of both signs */
                  static const uint32_t strange[] = { 0x7fc00000u, 0xffc00001u, 0x7f800000u, 0xff800000u };
                  scores[e] = from_bits(strange[pick(&seed, 0, 3)]);
               }
               if (ties == 3) scores[e] = pick(&seed, 0, 1) ? -0.0f : (float)pick(&seed, 0, 2) - 1; /* -0 ties with 0 */
            }
            dn_pool_contract(&m.g, scores, &m.c, m.scratch);
            check_clusters(&m, scores, "dn_pool_contract");
            memset(m.c.members, 0x5a, n * 8), memset(m.c.cluster, 0x5a, n * 4), m.c.count = 77;
            dn_pool_contract_ref(&m.g, scores, &m.c, m.scratch);
            check_clusters(&m, scores, "dn_pool_contract_ref");
            free(scores);
            meshy_free(&m);
         }
   AT_LEAST(cases, 190, "graphs");
}
TEST(ties_go_to_the_smaller_i_then_j)
{
   /* a square 0-1-2-3 with all scores equal: (0,1), then (2,3) */
   static const unsigned char square[] = { 0, 1, 0, 1, 1, 0, 1, 0, 0, 1, 0, 1, 1, 0, 1, 0 };
   static const float equal[8] = { 0.5f, 0.5f, 0.5f, 0.5f, 0.5f, 0.5f, 0.5f, 0.5f };
   static const uint32_t members[] = { 0, 1, 2, 3 };
   meshy m = meshy_of(square, 4);
   dn_pool_contract(&m.g, equal, &m.c, m.scratch);
   CHECK(m.c.count == 2 && memcmp(m.c.members, members, sizeof members) == 0);
   CHECK(m.c.coarse_first[1] == 1 && m.c.coarse_first[2] == 2 && m.c.coarse_next[0] == 1 && m.c.coarse_next[1] == 0);
   meshy_free(&m);
}
TEST(the_direction_of_the_better_score_is_kept)
{
   static const unsigned char pair[] = { 0, 1, 1, 0 };
   static const float scores[] = { 0.25f, 0.75f }; /* (0,1), (1,0) */
   meshy m = meshy_of(pair, 2);
   dn_pool_contract(&m.g, scores, &m.c, m.scratch);
   CHECK(m.c.count == 1 && m.c.members[0] == 1 && m.c.members[1] == 0 && m.c.score[0] == 0.75f);
   CHECK(m.c.coarse_first[0] == 0 && m.c.coarse_first[1] == 0);
   meshy_free(&m);
}
TEST(nothing_to_contract)
{
   static const unsigned char alone[9] = { 0 };
   meshy m = meshy_of(alone, 3);
   dn_pool_contract(&m.g, NULL, &m.c, m.scratch);
   CHECK(m.c.count == 3 && m.c.members[4] == 2 && m.c.members[5] == 2 && m.c.score[1] == 1 && m.c.coarse_first[3] == 0);
   meshy_free(&m);
   m = meshy_of(alone, 0);
   dn_pool_contract(&m.g, NULL, &m.c, m.scratch);
   CHECK(m.c.count == 0 && m.c.coarse_first[0] == 0);
   meshy_free(&m);
}

/* --- scores and the two formulas */
static void split_oddly(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job)
{
   size_t pieces = (count + grain - 1) / grain;
   (void)user;
   while (pieces-- > 0) fn(job, pieces * grain, (pieces + 1) * grain < count ? (pieces + 1) * grain : count, 0);
}
typedef struct pool_case {
   dn_pool pool;
   size_t in, features;
   float *lin, *dst, *src;
   void *memory;
} pool_case;
static pool_case random_pool(uint64_t *seed, size_t in, size_t features, float offset)
{
   pool_case p;
   p.in = in, p.features = features;
   p.lin = random_floats(seed, in * features, 0.7f);
   p.dst = random_floats(seed, features, 1);
   p.src = random_floats(seed, features, 1);
   p.memory = test_aligned(dn_pool_size(in, features));
   dn_pool_pack(&p.pool, in, features, p.lin, p.dst, p.src, offset, p.memory);
   return p;
}
static void pool_free(pool_case *p)
{
   free(p->lin), free(p->dst), free(p->src);
   test_aligned_free(p->memory);
}
TEST(scores_are_the_definition)
{
   uint64_t seed = 29;
   size_t n, i, e, f, d, hubs = 0;
   for (n = 0; n < 24; n++) {
      size_t in = n + 1, N = n % 5 ? pick(&seed, 1, 30) : pick(&seed, 150, 250) /* hubs of more than a run's neighbours */,
             stride = in + pick(&seed, 0, 3);
      pool_case p = random_pool(&seed, in, pick(&seed, 1, 9), 0);
      meshy m = random_meshy(&seed, N, (int)(n % KINDS));
      float *v = random_floats(&seed, N * stride, 1), *s = (float *)test_block(m.edges * 4);
      float *plain = (float *)test_block(m.edges * 4);
      double *dst = (double *)test_block(N * sizeof(double)), *src = (double *)test_block(N * sizeof(double));
      dn_pool_scores(&p.pool, &m.g, v, stride, s, m.scratch, NULL);
      dn_pool_scores_ref(&p.pool, &m.g, v, stride, plain);
      for (e = 0; e < m.edges; e++) CHECK(close_to((double)s[e], (double)plain[e]));
      for (i = 0; i < N; i++)
         for (dst[i] = src[i] = 0, f = 0; f < p.features; f++) {
            double z = 0;
            for (d = 0; d < in; d++) z += (double)p.lin[f * in + d] * (double)v[i * stride + d];
            dst[i] += (double)p.dst[f] * z;
            src[i] += (double)p.src[f] * z;
         }
      for (i = 0; i < N; i++) {
         double sum = 0, total = 0;
         for (e = m.first[i]; e < m.first[i + 1]; e++) {
            double x = dst[i] + src[m.next[e]];
            sum += exp(x < 0 ? 0.2 * x : x);
            total += (double)s[e];
         }
         CHECK(m.first[i] == m.first[i + 1] || fabs(total - 1) < 1e-5);
         for (e = m.first[i]; e < m.first[i + 1]; e++) {
            double x = dst[i] + src[m.next[e]];
            CHECK(close_to((double)s[e], exp(x < 0 ? 0.2 * x : x) / sum));
         }
      }
      dn_pool_contract(&m.g, s, &m.c, m.scratch);
      for (i = 0; i < m.c.count; i++) { /* rescoring finds the scores again */
         float kept = m.c.score[i];
         if (m.c.members[2 * i] != m.c.members[2 * i + 1]) m.c.score[i] = 55;
         dn_pool_rescore(&p.pool, &m.g, v, stride, &m.c, NULL);
         CHECK(close_to((double)m.c.score[i], (double)kept));
      }
      for (i = 0; i < m.c.count; i++) { /* and the other way round: hubs of more neighbours than one run has */
         uint32_t from = m.c.members[2 * i + 1], to = m.c.members[2 * i];
         m.c.members[2 * i] = from, m.c.members[2 * i + 1] = to;
         for (e = m.first[from]; e < m.first[from + 1] && m.next[e] != to; e++) {}
         dn_pool_rescore(&p.pool, &m.g, v, stride, &m.c, NULL);
         if (from != to) CHECK(e < m.first[from + 1] && close_to((double)m.c.score[i], (double)s[e]));
         hubs += from != to && m.first[from + 1] - m.first[from] > 32;
      }
      free(v), free(s), free(plain), free(dst), free(src);
      meshy_free(&m);
      pool_free(&p);
   }
   AT_LEAST(hubs, 2, "hubs");
}
TEST(gather_and_scatter_are_the_formulas)
{
   static const float offsets[] = { 0, 0.5f, -0.25f };
   uint64_t seed = 37;
   size_t n, i, x, tiny = 0;
   for (n = 0; n < 30; n++) {
      size_t N = pick(&seed, 1, 40), width = pick(&seed, 1, 20);
      size_t vs = width + pick(&seed, 0, 2), cs = width + pick(&seed, 0, 2);
      pool_case p = random_pool(&seed, 3, 2, offsets[n % 3]);
      meshy m = random_meshy(&seed, N, (int)(n % KINDS));
      float *s = random_floats(&seed, m.edges, 1), *v = random_floats(&seed, N * vs, 1);
      float *coarse = (float *)test_block(N * cs * 4), *back = (float *)test_block(N * vs * 4);
      float *plain = (float *)test_block(N * vs * 4);
      for (i = 0; i < m.edges; i++) s[i] = fabsf(s[i]) * (pick(&seed, 0, 3) ? 1e-6f : 1.0f);
      dn_pool_contract(&m.g, s, &m.c, m.scratch);
      dn_pool_gather(&p.pool, &m.c, v, vs, width, coarse, cs, NULL);
      dn_pool_scatter(&p.pool, &m.c, coarse, cs, width, N, back, vs, NULL);
      for (i = 0; i < m.c.count; i++) {
         size_t a = m.c.members[2 * i], b = m.c.members[2 * i + 1];
         double factor = (double)m.c.score[i] + (double)offsets[n % 3];
         if (factor < 1e-6) factor = 1e-6, tiny++;
         for (x = 0; x < width; x++) {
            double sum = (double)v[a * vs + x] + (double)v[b * vs + x], got = (double)coarse[i * cs + x];
            if (a == b) {
               CHECK(coarse[i * cs + x] == v[a * vs + x] && back[a * vs + x] == v[a * vs + x]);
            } else {
               CHECK(fabs(got - factor * sum) <= 1e-6 * fabs(factor));
               CHECK(close_to((double)back[a * vs + x], got / factor) && back[a * vs + x] == back[b * vs + x]);
            }
         }
      }
      dn_pool_scatter_ref(&p.pool, &m.c, coarse, cs, width, N, plain, vs);
      for (i = 0; i < N; i++)
         for (x = 0; x < width; x++) CHECK(close_to((double)back[i * vs + x], (double)plain[i * vs + x]));
      dn_pool_gather_ref(&p.pool, &m.c, v, vs, width, plain, width);
      for (i = 0; i < m.c.count; i++)
         for (x = 0; x < width; x++) CHECK(close_to((double)coarse[i * cs + x], (double)plain[i * width + x]));
      free(s), free(v), free(coarse), free(back), free(plain);
      meshy_free(&m);
      pool_free(&p);
   }
   AT_LEAST(tiny, 20, "scores under 1e-6");
}
TEST(bits_do_not_depend_on_the_split)
{
   uint64_t seed = 43;
   size_t N = 600, width = 13, i;
   dn_parallel split;
   pool_case p = random_pool(&seed, width, 4, 0.5f);
   meshy m = random_meshy(&seed, N, SPARSE);
   float *v = random_floats(&seed, N * width, 1), *kept = (float *)test_block(N * 4);
   float *s[2], *coarse[2], *back[2];
   split.run = split_oddly, split.user = NULL, split.workers = 4;
   for (i = 0; i < 2; i++) {
      const dn_parallel *par = i ? &split : NULL;
      s[i] = (float *)test_block(m.edges * 4);
      coarse[i] = (float *)test_block(N * width * 4);
      back[i] = (float *)test_block(N * width * 4);
      dn_pool_scores(&p.pool, &m.g, v, width, s[i], m.scratch, par);
      dn_pool_contract(&m.g, s[i], &m.c, m.scratch);
      dn_pool_rescore(&p.pool, &m.g, v, width, &m.c, par);
      if (i == 0) memcpy(kept, m.c.score, m.c.count * 4);
      dn_pool_gather(&p.pool, &m.c, v, width, width, coarse[i], width, par);
      dn_pool_scatter(&p.pool, &m.c, coarse[i], width, width, N, back[i], width, par);
   }
   CHECK(memcmp(s[0], s[1], m.edges * 4) == 0);
   CHECK(memcmp(kept, m.c.score, m.c.count * 4) == 0);
   CHECK(memcmp(coarse[0], coarse[1], m.c.count * width * 4) == 0);
   CHECK(memcmp(back[0], back[1], N * width * 4) == 0);
   for (i = 0; i < 2; i++) free(s[i]), free(coarse[i]), free(back[i]);
   free(v), free(kept);
   meshy_free(&m);
   pool_free(&p);
}

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(contraction_is_the_greedy_one);
   RUN(ties_go_to_the_smaller_i_then_j);
   RUN(the_direction_of_the_better_score_is_kept);
   RUN(nothing_to_contract);
   RUN(scores_are_the_definition);
   RUN(gather_and_scatter_are_the_formulas);
   RUN(bits_do_not_depend_on_the_split);
   return TEST_END();
}
