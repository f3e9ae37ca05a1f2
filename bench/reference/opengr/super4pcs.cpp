// Super4PCS as its authors wrote it (OpenGR), on two clouds in text files: the peer of bench/super4pcs.py.
//
//     super4pcs SOURCE TARGET DELTA OVERLAP SAMPLES NORMAL_DEGREES COLOR_DISTANCE SECONDS
//
// A line of a cloud is "x y z nx ny nz r g b", meters, unit normals (zeros: unknown) and colors in [0, 255] (negative:
// unknown). DELTA is in meters, OVERLAP and the score in [0, 1]; filters that are not above 0 are off. Written to the
// standard output: four rows of the transform x_target = R x_source + t, the score (share of SAMPLES within DELTA), and
// the seconds of the search.

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <vector>

#include "gr/algorithms/FunctorSuper4pcs.h"
#include "gr/algorithms/PointPairFilter.h"
#include "gr/algorithms/match4pcsBase.h"
#include "gr/utils/logger.h"
#include "gr/utils/sampling.h"
#include "gr/utils/shared.h"

using Point = gr::Point3D<float>;
using Vector = Point::VectorType;
using Visitor = gr::DummyTransformVisitor;
using Matcher = gr::Match4pcsBase<gr::FunctorSuper4PCS, Point, Visitor, gr::AdaptivePointFilter,
                                  gr::AdaptivePointFilter::Options>;

static std::vector<Point> read(const char* path) {
    std::ifstream file(path);
    std::vector<Point> points;
    float v[9];
    while (file >> v[0] >> v[1] >> v[2] >> v[3] >> v[4] >> v[5] >> v[6] >> v[7] >> v[8]) {
        Point point(v[0], v[1], v[2]);
        const Vector normal(v[3], v[4], v[5]);
        if (normal.squaredNorm() > 0) point.set_normal(normal);
        point.set_rgb(Vector(v[6], v[7], v[8]));
        points.push_back(point);
    }
    return points;
}

int main(int count, char** given) {
    if (count != 9) {
        std::fprintf(stderr, "expected SOURCE TARGET DELTA OVERLAP SAMPLES NORMAL_DEGREES COLOR_DISTANCE SECONDS\n");
        return 2;
    }
    const std::vector<Point> source = read(given[1]), target = read(given[2]);
    Matcher::OptionsType options;
    options.delta = std::atof(given[3]);
    options.configureOverlap(std::atof(given[4]));
    options.sample_size = std::atoi(given[5]);
    options.max_normal_difference = std::atof(given[6]);
    options.max_color_distance = std::atof(given[7]);
    options.max_time_seconds = std::atoi(given[8]);
    gr::Utils::Logger logger(gr::Utils::NoLog);
    gr::UniformDistSampler<Point> sampler;
    Visitor visitor;
    Matcher matcher(options, logger);
    Eigen::Matrix4f T = Eigen::Matrix4f::Identity();
    const auto begin = std::chrono::steady_clock::now();
    const float score = matcher.ComputeTransformation(target, source, T, sampler, visitor);  // moves the second cloud
    const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - begin;
    for (int i = 0; i < 4; ++i) std::printf("%.9g %.9g %.9g %.9g\n", T(i, 0), T(i, 1), T(i, 2), T(i, 3));
    std::printf("%.6f %.3f\n", score, taken.count());
    return 0;
}
