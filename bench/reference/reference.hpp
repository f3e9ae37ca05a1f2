// What all programs share: the cloud they read, what they write, and the clock.
//
// A program is one source file, whose `main` hands `reference::run` a function that computes one descriptor of a cloud:
//
//     int main(int count, char** words) {
//         return reference::run(count, words, [](const reference::Input& input) {
//             pcl::PFHEstimation<pcl::PointXYZ, pcl::Normal, pcl::PFHSignature125> estimation;
//             reference::set(estimation, input);
//             pcl::PointCloud<pcl::PFHSignature125> result;
//             const double seconds = reference::timed([&] { estimation.compute(result); });
//             return reference::Output{seconds, reference::rows(result, 125, [](const auto& p) { return p.histogram; })};
//         });
//     }
#pragma once

#include <pcl/point_cloud.h>
#include <pcl/point_types.h>
#include <pcl/search/kdtree.h>

#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <fstream>
#include <iostream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace reference {

struct Input {
    pcl::PointCloud<pcl::PointXYZ>::Ptr points{new pcl::PointCloud<pcl::PointXYZ>};
    pcl::PointCloud<pcl::PointXYZRGB>::Ptr colored{new pcl::PointCloud<pcl::PointXYZRGB>};  // the same points
    pcl::PointCloud<pcl::Normal>::Ptr normals{new pcl::PointCloud<pcl::Normal>};
    double radius;                     // of the neighborhoods, in the unit of the points
    int threads;                       // for classes that take a number of them
    std::vector<std::string> options;  // what a program takes beyond
};

struct Output {
    double seconds;             // of the computation alone, its search included
    std::vector<float> values;  // (P, D), row by row
};

// Lines of nine numbers: x y z, unit normal, red green blue in 0..255.
inline void read(const std::string& path, Input& input) {
    std::ifstream file(path);
    if (!file) throw std::runtime_error("cannot read " + path);
    std::string line;
    while (std::getline(file, line)) {
        if (line.empty() || line[0] == '#') continue;
        std::istringstream words(line);
        float v[9];
        for (float& value : v)
            if (!(words >> value)) throw std::runtime_error("expected nine numbers, got: " + line);
        input.points->push_back(pcl::PointXYZ(v[0], v[1], v[2]));
        pcl::PointXYZRGB colored;
        colored.x = v[0], colored.y = v[1], colored.z = v[2];
        colored.r = static_cast<std::uint8_t>(std::lround(v[6]));
        colored.g = static_cast<std::uint8_t>(std::lround(v[7]));
        colored.b = static_cast<std::uint8_t>(std::lround(v[8]));
        input.colored->push_back(colored);
        input.normals->push_back(pcl::Normal(v[3], v[4], v[5]));
    }
}

// Cloud, search and radius of an estimation on `points`; normals are set where the class takes them.
template <typename Estimation>
void set_cloud(Estimation& estimation, const Input& input, pcl::PointCloud<pcl::PointXYZ>::Ptr points) {
    estimation.setInputCloud(points);
    estimation.setSearchMethod(pcl::search::KdTree<pcl::PointXYZ>::Ptr(new pcl::search::KdTree<pcl::PointXYZ>));
    estimation.setRadiusSearch(input.radius);
}

template <typename Estimation>
void set_cloud(Estimation& estimation, const Input& input, pcl::PointCloud<pcl::PointXYZRGB>::Ptr points) {
    estimation.setInputCloud(points);
    estimation.setSearchMethod(pcl::search::KdTree<pcl::PointXYZRGB>::Ptr(new pcl::search::KdTree<pcl::PointXYZRGB>));
    estimation.setRadiusSearch(input.radius);
}

template <typename Estimation>
void set(Estimation& estimation, const Input& input) {
    set_cloud(estimation, input, input.points);
    estimation.setInputNormals(input.normals);
}

template <typename Estimation>
void set_colored(Estimation& estimation, const Input& input) {
    set_cloud(estimation, input, input.colored);
    estimation.setInputNormals(input.normals);
}

template <typename Body>
double timed(Body body) {
    const auto begin = std::chrono::steady_clock::now();
    body();
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

// Rows of `size` numbers, which `row` points to for every point of a result.
template <typename Cloud, typename Row>
std::vector<float> rows(const Cloud& cloud, std::size_t size, Row row) {
    std::vector<float> values;
    values.reserve(cloud.size() * size);
    for (const auto& point : cloud) values.insert(values.end(), row(point), row(point) + size);
    return values;
}

// PROGRAM CLOUD RADIUS VALUES [THREADS [RUNS [OPTIONS...]]]: writes the values of the last run, float32 as they lie in
// memory, to the file VALUES ("-": nowhere), and prints a line of words and numbers.
template <typename Compute>
int run(int count, char** words, Compute compute) {
    try {
        if (count < 4) throw std::runtime_error("usage: PROGRAM CLOUD RADIUS VALUES [THREADS [RUNS [OPTIONS...]]]");
        Input input;
        read(words[1], input);
        input.radius = std::atof(words[2]);
        input.threads = count > 4 ? std::atoi(words[4]) : 1;
        const int runs = count > 5 ? std::atoi(words[5]) : 1;
        for (int i = 6; i < count; ++i) input.options.push_back(words[i]);
        std::printf("points %zu radius %s threads %d seconds", input.points->size(), words[2], input.threads);
        Output output;
        for (int i = 0; i < runs; ++i) {
            output = compute(std::as_const(input));
            std::printf(" %.4f", output.seconds);
        }
        std::printf("\n");
        if (std::string(words[3]) != "-") {
            std::ofstream file(words[3], std::ios::binary);
            file.write(reinterpret_cast<const char*>(output.values.data()), output.values.size() * sizeof(float));
            if (!file) throw std::runtime_error(std::string("cannot write ") + words[3]);
        }
        return 0;
    } catch (const std::exception& error) {
        std::cerr << error.what() << "\n";
        return 1;
    }
}

}  // namespace reference
