// What Python gives a kernel, held against what the kernel declares: the one place where arrays are
// checked. It reads them by Python's buffer protocol, whose few functions `library.py` hands in, so
// that the library is built without Python and fits all of them.
#include "border.hpp"

namespace {

// As `Py_buffer` of CPython's stable interface since 3.11.
struct Buffer {
    void* data;
    void* owner;
    std::ptrdiff_t bytes, item_bytes;
    int is_read_only, dimensions;
    char* format;
    std::ptrdiff_t *shape, *strides, *suboffsets;
    void* internal;
};
constexpr int STRIDES_AND_FORMAT = 0x18 | 0x4;  // PyBUF_STRIDES | PyBUF_FORMAT: read-only does

struct Python {
    void* (*tuple_item)(void*, std::ptrdiff_t);
    int (*get_buffer)(void*, Buffer*, int);
    void (*release_buffer)(Buffer*);
    double (*as_double)(void*);
    long long (*as_whole)(void*);
    void* (*error_occurred)();
    void (*clear_error)();
    int (*is_instance)(void*, void*);
    void* array_type;  // numpy's
};

// One parameter of a kernel, as `library.py` packs it.
struct Parameter {
    std::int32_t kind;  // 0 array, 1 whole number, 2 number, 3 object (its address)
    char number;        // of an array: 'f' real, 'i' signed, 'u' unsigned, '?' bool
    std::int8_t item_bytes, dimensions, is_written;
    std::int64_t axes[3];  // a length, or -1 - n for the n-th letter
};

enum Fault : std::int64_t { NONE, TYPE, SHAPE, PIECES, READ_ONLY };
constexpr int MOST_LETTERS = 24, MOST_FAULTS = 8;

char kind_of(char format) {
    switch (format) {
        case 'f':
        case 'd':
            return 'f';
        case 'b':
        case 'h':
        case 'i':
        case 'l':
        case 'q':
            return 'i';
        case 'B':
        case 'H':
        case 'I':
        case 'L':
        case 'Q':
            return 'u';
        default:
            return format;
    }
}

Fault fault_in(const Buffer& buffer, const Parameter& wanted, std::int64_t* lengths) {
    const char* format = buffer.format == nullptr ? "B" : buffer.format;
    // As numpy marks what does not lie where its type may.
    if (format[0] == '=' || format[0] == '^') return PIECES;
    if (format[1] != '\0' || kind_of(format[0]) != wanted.number ||
        buffer.item_bytes != wanted.item_bytes)
        return TYPE;
    if (buffer.dimensions != wanted.dimensions) return SHAPE;
    for (int axis = 0; axis < buffer.dimensions; ++axis) {
        std::int64_t expected = wanted.axes[axis];
        if (expected < 0) {
            std::int64_t& known = lengths[-1 - expected];
            if (known < 0) known = buffer.shape[axis];
            expected = known;
        }
        if (buffer.shape[axis] != expected) return SHAPE;
    }
    std::ptrdiff_t next = buffer.item_bytes;
    for (int axis = buffer.dimensions - 1; axis >= 0 && buffer.bytes > 0; --axis) {
        if (buffer.shape[axis] != 1 && buffer.strides[axis] != next) return PIECES;
        next *= buffer.shape[axis];
    }
    if (reinterpret_cast<std::uintptr_t>(buffer.data) % static_cast<std::size_t>(wanted.item_bytes))
        return PIECES;
    return wanted.is_written && buffer.is_read_only ? READ_ONLY : NONE;
}

Fault packed(const Python& python, void* value, const Parameter& wanted, std::int64_t* lengths,
             trigpoint::Argument& argument) {
    if (wanted.kind == 0) {
        Buffer buffer;
        if (python.is_instance(value, python.array_type) != 1 ||
            python.get_buffer(value, &buffer, STRIDES_AND_FORMAT) != 0) {
            python.clear_error();
            return TYPE;
        }
        const Fault fault = fault_in(buffer, wanted, lengths);
        argument.array.data = buffer.data;
        for (int axis = 0; axis < 3; ++axis)
            argument.array.shape[axis] =
                fault == NONE && axis < buffer.dimensions ? buffer.shape[axis] : 0;
        python.release_buffer(&buffer);  // the caller holds the array
        return fault;
    }
    if (wanted.kind == 2)
        argument.number = python.as_double(value);
    else
        argument.whole = python.as_whole(value);
    if (python.error_occurred() == nullptr) return NONE;
    python.clear_error();
    return TYPE;
}

}  // namespace

// With the interpreter's lock held: packs a tuple of as many values as there are parameters. 0, or
// the first that does not fit and why, as 8 · its number + the fault.
extern "C" __attribute__((visibility("default"))) std::int64_t trigpoint_pack(
    void* values, const void* parameters, std::int64_t count, const void* python,
    trigpoint::Argument* arguments) {
    const auto& api = *static_cast<const Python*>(python);
    const auto* wanted = static_cast<const Parameter*>(parameters);
    std::int64_t lengths[MOST_LETTERS];
    for (std::int64_t& length : lengths) length = -1;
    for (std::int64_t n = 0; n < count; ++n) {
        const Fault fault =
            packed(api, api.tuple_item(values, n), wanted[n], lengths, arguments[n]);
        if (fault != NONE) return MOST_FAULTS * n + fault;
    }
    return 0;
}
