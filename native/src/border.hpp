// The border to Python: arrays as they come in, and errors as they go out.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <cstring>
#include <exception>
#include <new>

// Of loops over whole pictures: also compiled for wider registers, which is chosen at run time.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__SANITIZE_ADDRESS__)
#define TRIGPOINT_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define TRIGPOINT_WIDE
#endif

namespace trigpoint {

// An array in one piece, row by row; its type and shape were checked by `packing.cpp`.
struct Array {
    void* data;
    std::int64_t shape[3];

    template <class T>
    T* as() const {
        return static_cast<T*>(data);
    }
    // A matrix (shape[0], N) of doubles in place.
    template <int N>
    Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, N, N == 1 ? Eigen::ColMajor : Eigen::RowMajor>>
    rows() const {
        return {as<double>(), shape[0], N};
    }
};

// What a function is given, one after the other, as `packing.cpp` packs them.
union Argument {
    Array array;
    std::int64_t whole;
    double number;
    void* object;
};

constexpr std::int64_t FAILED = -1, NO_MEMORY = -2;
constexpr std::size_t ERROR_BYTES = 256;

// Runs what an exported function does; no exception crosses the border.
template <class Work>
std::int64_t guarded(char* error, Work&& work) noexcept {
    try {
        return work();
    } catch (const std::bad_alloc&) {
        return NO_MEMORY;
    } catch (const std::exception& failure) {
        std::strncpy(error, failure.what(), ERROR_BYTES - 1);
        return FAILED;
    } catch (...) {
        std::strncpy(error, "unknown failure", ERROR_BYTES - 1);
        return FAILED;
    }
}

}  // namespace trigpoint

// Defines an exported function `name` of `arguments`; its body returns what it counts, 0 or more.
#define TRIGPOINT_KERNEL(name)                                                    \
    static std::int64_t name##_body(const trigpoint::Argument* arguments);        \
    extern "C" __attribute__((visibility("default"))) std::int64_t name(          \
        const trigpoint::Argument* arguments, char* error) {                      \
        return trigpoint::guarded(error, [&] { return name##_body(arguments); }); \
    }                                                                             \
    static std::int64_t name##_body([[maybe_unused]] const trigpoint::Argument* arguments)

// Defines `name_new` and `name_free` of an object that Python holds as a Handle.
#define TRIGPOINT_OBJECT(name, Type)                                                         \
    extern "C" __attribute__((visibility("default"))) std::int64_t name##_new(void** made,   \
                                                                              char* error) { \
        return trigpoint::guarded(error, [&] {                                               \
            *made = new Type();                                                              \
            return std::int64_t{0};                                                          \
        });                                                                                  \
    }                                                                                        \
    extern "C" __attribute__((visibility("default"))) std::int64_t name##_free(void* made,   \
                                                                               char*) {      \
        delete static_cast<Type*>(made);                                                     \
        return 0;                                                                            \
    }
