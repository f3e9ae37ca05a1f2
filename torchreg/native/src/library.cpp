// What Python asks of the library itself.
#include "common.hpp"

#ifndef TORCHREG_SOURCES
#define TORCHREG_SOURCES "unknown"
#endif

#if defined(_WIN32)
extern "C" __declspec(dllexport) const char* torchreg_sources() { return TORCHREG_SOURCES; }
#else
extern "C" __attribute__((visibility("default"))) const char* torchreg_sources() { return TORCHREG_SOURCES; }
#endif
