// The X-shaped corners of checkerboards in a picture.
//
// Such a corner is a saddle of brightness: the determinant of the Hessian of the smoothed picture
// is strongly negative there. On a ring around it brightness goes light, dark, light, dark, so that
// the ring's even harmonics hold nearly all of its power (after the idea of Bennett and Lasenby,
// «ChESS», 2014); edges, blobs, T and L junctions do not pass.
#pragma once

#include <cstdint>
#include <vector>

#include "image/memory.hpp"
#include "image/picture.hpp"

namespace trigpoint {

// Bounds on the work in a picture that is all corners; the strongest stay.
constexpr std::size_t MOST_CANDIDATES = 2500, MOST_SADDLES = 800;

struct Place {
    float x, y;
};

// One X corner. `directions`: angles of the four edges that leave it, rising (from x towards y), so
// that the sector from direction 0 to 1 is light, from 1 to 2 dark and so on; `amplitude`: half the
// difference between light and dark, grey levels.
struct Saddle {
    Place pixel;
    float directions[4];
    float amplitude;
};

// A smoothed picture, and where its brightness bends like a saddle; kept for the next picture.
class Curvature {
public:
    // Smooth a picture, and find the X corners in it.
    void take(const Grey& grey);
    // The same with another's picture at half the size: pixel (x, y) is its smooth (2 x, 2 y).
    void take_half(const Curvature& finer);
    // The X corners, the strongest first.
    const std::vector<Saddle>& saddles() const { return saddles_; }
    // The X corner nearest to a place, moved to the saddle by one Newton step; whether there is
    // one. A `tolerance` above 1 lets weaker ones pass, where it is known that one should be there.
    bool examine(Place place, float tolerance, Saddle& saddle) const;

    std::int64_t width() const { return width_; }
    std::int64_t height() const { return height_; }

private:
    struct Candidate {
        float strength;
        Place pixel;
    };
    struct Bends {
        float xx, yy, xy;
    };

    // Begins with a picture of that size; whether it is large enough.
    bool begin(std::int64_t width, std::int64_t height);
    // Smooths the picture whose row y `put` puts into place, and finds what may be corners.
    template <class Put>
    void smooth(const Put& put);
    void keep_saddles();
    void peaks(std::int64_t y);
    float* strength(std::int64_t y) { return strength_.data() + (y % 5) * width_; }
    Bends bends(std::int64_t x, std::int64_t y) const;

    std::int64_t width_ = 0, height_ = 0;
    std::vector<float> padded_, across_, strength_;
    std::vector<float, LargePages<float>> smooth_;
    std::vector<std::uint8_t> might_peak_;
    std::vector<Candidate> candidates_;
    std::vector<Saddle> saddles_;
};

}  // namespace trigpoint
