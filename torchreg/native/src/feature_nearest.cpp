// Exact nearest rows in feature space, from lower bounds in few dimensions: torchreg/matching/shadows.py.
#include "vectors.hpp"

namespace torchreg {
namespace {

constexpr float NEVER = std::numeric_limits<float>::infinity();
constexpr double ROOTS = 1e-14;        // relative, far above what squares of one root differ by
constexpr int64_t BUFFER = 64 * 1024;  // floats of bounds at a time: they stay in the second cache
constexpr int64_t PIECE = 96;          // queries, a multiple of TALL
constexpr int64_t SPARE = 8 * 1024;    // full comparisons of a piece beyond some dozens of each query: a crowd ends them
constexpr int64_t FIRST = 4;           // rows at least whose distance is computed before others are ruled out

constexpr int64_t WIDE = 2 * WIDTH;  // columns of a panel
constexpr int64_t MANY = 8;            // panels that are looked through at once

int64_t lowest(uint32_t bits) {
#if defined(__GNUC__)
    return __builtin_ctz(bits);
#else
    int64_t place = 0;
    while (!(bits >> place & 1)) ++place;
    return place;
#endif
}

// The `place`-th least of a vector.
float ranked(Floats lanes, int64_t place) {
    float values[WIDTH], sorted[WIDTH];
    lanes.store(values);
    std::fill(sorted, sorted + place + 1, NEVER);
    for (float value : values) {
        if (!(value < sorted[place])) continue;
        int64_t k = place;
        for (; k > 0 && sorted[k - 1] > value; --k) sorted[k] = sorted[k - 1];
        sorted[k] = value;
    }
    return sorted[place];
}

// The table's shadows in panels of WIDE rows, dimension by dimension, and their squared lengths.
struct Panels {
    int64_t count, width;
    std::vector<float> factors;  // (panels, width, WIDE)
    std::vector<float> squares;  // (panels, WIDE), infinity beyond the last row

    Panels(const float* shadow, const double* norm, int64_t rows, int64_t width)
        : count((rows + WIDE - 1) / WIDE), width(width), factors(count * width * WIDE), squares(count * WIDE, NEVER) {
        for (int64_t row = 0; row < rows; ++row) {
            float* panel = &factors[row / WIDE * width * WIDE + row % WIDE];
            for (int64_t k = 0; k < width; ++k) panel[k * WIDE] = shadow[row * width + k];
            squares[row] = float(norm[row] * norm[row]);
        }
    }
};

// Bounds of TALL queries against one panel, to out (TALL, stride).
// left is (width, TALL), -2 times the shadows of the queries, square (TALL) their squared lengths.
void bounds(const float* left, const float* square, const float* panel, const float* squares, int64_t width, float* out,
            int64_t stride) {
    Floats low[TALL], high[TALL];
    const Floats first = Floats::load(squares), second = Floats::load(squares + WIDTH);
    for (int64_t row = 0; row < TALL; ++row) {
        const Floats own = Floats::all(square[row]);
        low[row] = first.plus(own);
        high[row] = second.plus(own);
    }
    for (int64_t k = 0; k < width; ++k) {
        const Floats a = Floats::load(panel + k * WIDE), b = Floats::load(panel + k * WIDE + WIDTH);
        for (int64_t row = 0; row < TALL; ++row) {
            const Floats factor = Floats::all(left[k * TALL + row]);
            low[row] = low[row].plus_product(factor, a);
            high[row] = high[row].plus_product(factor, b);
        }
    }
    for (int64_t row = 0; row < TALL; ++row) {
        low[row].store(out + row * stride);
        high[row].store(out + row * stride + WIDTH);
    }
}

// A float not below a double.
float above(double value) {
    const float rounded = float(value);
    return double(rounded) < value ? std::nextafter(rounded, NEVER) : rounded;
}

struct Candidate {
    double square;  // of the distance, to rounding
    int64_t row;
};

// What is known of the nearest rows of one query.
template <typename Real>
struct Search {
    const double* query;  // (width)
    const Real* table;    // (rows, width)
    int64_t width, count, most;
    int64_t* spare;  // visits beyond `most` that a piece of the queries has left
    bool tied;       // there were more
    double norm, scale, unit, tiny, rounding;
    double reach;  // no farther, squared, are the nearest ones sought
    float limit;   // no greater are their bounds
    std::vector<Candidate> candidates, exact;
    std::vector<float> least;  // bounds of groups of MANY panels, by lane
    std::vector<double> nearest;  // (count), squared distances, ascending

    void begin(double bound) {
        tied = false;
        candidates.clear();
        std::fill(nearest.begin(), nearest.end(), std::numeric_limits<double>::infinity());
        reach = bound * bound * (1 + rounding);
        tighten();
    }

    void tighten() {
        const double distance = std::sqrt(reach) / scale, sum = 2 * norm + distance;
        limit = above(distance * distance + unit * (sum * sum) + tiny);
    }

    // Whether another row may be compared in full.
    bool may_visit() {
        if (int64_t(candidates.size()) < most || --*spare >= 0) return true;
        tied = true;
        return false;
    }

    void visit(int64_t row) {
        const Real* other = table + row * width;
        Eight even = Eight::zero(), odd = Eight::zero();
        int64_t k = 0;
        for (; k + 16 <= width; k += 16) {
            even = even.plus_square(Eight::load(query + k).minus(Eight::load(other + k)));
            odd = odd.plus_square(Eight::load(query + k + 8).minus(Eight::load(other + k + 8)));
        }
        if (k + 8 <= width) {
            even = even.plus_square(Eight::load(query + k).minus(Eight::load(other + k)));
            k += 8;
        }
        double square = total(even.plus(odd));
        for (; k < width; ++k) {
            const double difference = query[k] - double(other[k]);
            square += difference * difference;
        }
        candidates.push_back({square, row});
        if (!(square < nearest[count - 1])) return;
        int64_t place = count - 1;
        for (; place > 0 && nearest[place - 1] > square; --place) nearest[place] = nearest[place - 1];
        nearest[place] = square;
        const double worst = nearest[count - 1] * (1 + rounding);
        if (worst < reach) {
            reach = worst;
            tighten();
        }
    }

    // Visit the rows from `first` on whose bounds (panels, WIDE), infinite after the last, are such that they may be
    // among the nearest. Those with the least bounds come first, so that most others need no visit.
    void look(const float* bound, int64_t panels, int64_t first) {
        const int64_t groups = (panels + MANY - 1) / MANY;
        if (int64_t(least.size()) < groups * WIDTH) least.resize(groups * WIDTH);
        Floats overall = Floats::all(NEVER);
        for (int64_t group = 0; group < groups; ++group) {
            const float* some = bound + group * MANY * WIDE;
            const int64_t vectors = 2 * std::min(MANY, panels - group * MANY);
            Floats even = Floats::load(some), odd = Floats::load(some + WIDTH);
            for (int64_t place = 2; place < vectors; place += 2) {
                even = even.least(Floats::load(some + place * WIDTH));
                odd = odd.least(Floats::load(some + (place + 1) * WIDTH));
            }
            even = even.least(odd);
            even.store(&least[group * WIDTH]);
            overall = overall.least(even);
        }
        const float early = ranked(overall, std::min(std::max(count, FIRST), WIDTH) - 1);
        float after = -NEVER;
        if (early < limit) {
            pass(bound, panels, first, after, early);
            after = early;
        }
        pass(bound, panels, first, after, NEVER);
    }

    // Visit rows with bounds in (after, until] and within the limit.
    void pass(const float* bound, int64_t panels, int64_t first, float after, float until) {
        for (int64_t group = 0; group * MANY < panels; ++group) {
            if (Floats::load(&least[group * WIDTH]).within(Floats::all(std::min(limit, until))) == 0) continue;
            const int64_t end = std::min(panels, (group + 1) * MANY) * WIDE;
            for (int64_t begin = group * MANY * WIDE; begin < end; begin += WIDTH) {
                uint32_t bits = Floats::load(bound + begin).within(Floats::all(std::min(limit, until)));
                for (; bits != 0; bits &= bits - 1) {
                    const int64_t column = begin + lowest(bits);
                    if (bound[column] > after && bound[column] <= limit && bound[column] < NEVER && may_visit())
                        visit(first + column);
                }
            }
        }
    }

    // The squared distances, added in the order of the columns, and their rows, ascending. Returns whether it can be
    // told: squares that differ by rounding alone may have the same root, or roots in another order.
    bool finish(int64_t* row, double* distance) {
        const double worst = nearest[count - 1] * (1 + rounding);
        exact.clear();
        for (const Candidate& candidate : candidates) {
            if (!(candidate.square <= worst)) continue;
            const Real* other = table + candidate.row * width;
            double sum = 0;
            for (int64_t k = 0; k < width; ++k) {
                const double difference = query[k] - double(other[k]);
                sum += difference * difference;
            }
            exact.push_back({sum, candidate.row});
        }
        std::sort(exact.begin(), exact.end(), [](const Candidate& one, const Candidate& other) {
            return one.square < other.square || (one.square == other.square && one.row < other.row);
        });
        for (size_t place = 1; place < exact.size(); ++place) {
            const double before = exact[place - 1].square, after = exact[place].square;
            if (int64_t(place) <= count && before != after && after <= before * (1 + ROOTS)) return false;
        }
        for (int64_t place = 0; place < count && place < int64_t(exact.size()); ++place) {
            distance[place] = exact[place].square;
            row[place] = exact[place].row;
        }
        return true;
    }
};

}  // namespace

template <typename Real>
int64_t feature_nearest(const Real* query, const float* query_shadow, const double* query_norm, int64_t queries,
                const Real* table, const float* table_shadow, const double* table_norm, int64_t rows, int64_t width,
                int64_t shadow_width, const double* bound, int64_t count, int64_t most, double scale, double unit,
                double tiny, int64_t* row, double* distance, int64_t threads) {
    const Panels panels(table_shadow, table_norm, rows, shadow_width);
    const int64_t step = std::min(panels.count, BUFFER / (TALL * WIDE));
    parallel(threads, queries, PIECE, [&](int64_t from, int64_t to, int64_t) {
        std::vector<float> left(shadow_width * TALL), square(TALL), buffer(TALL * step * WIDE);
        std::vector<double> own(TALL * width);
        std::vector<Search<Real>> searches(TALL);
        int64_t spare = SPARE;
        for (int64_t block = from; block < to; block += TALL) {
            const int64_t tall = std::min(TALL, to - block);
            for (int64_t i = 0; i < TALL; ++i) {
                const int64_t number = block + std::min(i, tall - 1);
                for (int64_t k = 0; k < shadow_width; ++k)
                    left[k * TALL + i] = -2 * query_shadow[number * shadow_width + k];
                square[i] = float(query_norm[number] * query_norm[number]);
                for (int64_t k = 0; k < width; ++k) own[i * width + k] = double(query[number * width + k]);
                Search<Real>& search = searches[i];
                search.query = &own[i * width];
                search.table = table;
                search.width = width, search.count = count, search.most = most, search.spare = &spare;
                search.norm = query_norm[number], search.scale = scale, search.unit = unit, search.tiny = tiny;
                search.rounding = double(width + 16) * 4 * std::numeric_limits<double>::epsilon();
                search.nearest.resize(count);
                search.begin(bound ? bound[number] : std::numeric_limits<double>::infinity());
            }
            for (int64_t first = 0; first < panels.count; first += step) {
                const int64_t some = std::min(step, panels.count - first);
                for (int64_t panel = 0; panel < some; ++panel)
                    bounds(left.data(), square.data(), &panels.factors[(first + panel) * shadow_width * WIDE],
                           &panels.squares[(first + panel) * WIDE], shadow_width, &buffer[panel * WIDE], step * WIDE);
                for (int64_t i = 0; i < tall; ++i) searches[i].look(&buffer[i * step * WIDE], some, first * WIDE);
            }
            for (int64_t i = 0; i < tall; ++i) {
                const int64_t number = block + i;
                int64_t* found = row + number * count;
                double* squares = distance + number * count;
                if (searches[i].tied || !searches[i].finish(found, squares)) {
                    found[0] = -1;
                    squares[0] = searches[i].reach;
                }
            }
        }
    });
    return 0;
}

// Equals `feature_nearest` of matching/nearest.py, for `shadows_nearest` of shadows.py.
//
// query (N, D) and table (M, D) with shadows (N, K) and (M, K) float32 and norms (N) and (M) float64, in units of
// `scale`; bound (N) float64, within which `count` rows lie, or null; `most` rows that are compared in full of a query;
// unit and tiny, errors of a bound. Writes row (N, count) int64 and distance (N, count) float64, squared; where ties are
// not settled, -1 and a bound of the squared distance come first.
KERNELS(feature_nearest,
        (const Real* query, const float* query_shadow, const double* query_norm, int64_t queries, const Real* table,
         const float* table_shadow, const double* table_norm, int64_t rows, int64_t width, int64_t shadow_width,
         const double* bound, int64_t count, int64_t most, double scale, double unit, double tiny, int64_t* row,
         double* distance, int64_t threads),
        (query, query_shadow, query_norm, queries, table, table_shadow, table_norm, rows, width, shadow_width, bound,
         count, most, scale, unit, tiny, row, distance, threads))

}  // namespace torchreg
