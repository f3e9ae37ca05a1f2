// What Python asks of the library itself.
#include "common.hpp"

#ifndef TORCHREG_SOURCES
#define TORCHREG_SOURCES "unknown"
#endif

extern "C" EXPORTED const char* torchreg_sources() { return TORCHREG_SOURCES; }
