// Memory for whole pictures.
#pragma once

#include <cstddef>
#include <cstdlib>
#include <new>
#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace trigpoint {

// In large pages where that much is asked for: the first writing to a page costs more than all that
// is then done with 4 kB of it.
template <class T>
struct LargePages {
    using value_type = T;
    static constexpr std::size_t PAGE = std::size_t{1} << 21;

    LargePages() = default;
    template <class Other>
    LargePages(const LargePages<Other>&) {}

    T* allocate(std::size_t count) {
        const std::size_t bytes = count * sizeof(T);
        const std::size_t page = bytes < PAGE ? alignof(std::max_align_t) : PAGE;
        void* memory = std::aligned_alloc(page, (bytes + page - 1) / page * page);
        if (memory == nullptr) throw std::bad_alloc();
#if defined(__linux__)
        if (bytes >= PAGE) madvise(memory, bytes, MADV_HUGEPAGE);
#endif
        return static_cast<T*>(memory);
    }
    void deallocate(T* memory, std::size_t) { std::free(memory); }
    template <class Other>
    bool operator==(const LargePages<Other>&) const {
        return true;
    }
    template <class Other>
    bool operator!=(const LargePages<Other>&) const {
        return false;
    }
};

}  // namespace trigpoint
