// The square of the outer radius of the first shell of a disk: to where, face to face, its form factor times its brightest
// band L falls below epsilon; for what is dim anyway, to its own radius, since many that are dim are not.
float first_reach2(float radius, float L, float epsilon) {
    return radius * radius * max(L / epsilon - 1.0, 1.0);
}

// The square of the distance across a scene, and some more: where the last shell ends if it is to miss nothing.
const float ACROSS2 = 4.1;

// A surfel's splat into one level: the part of its sub-buffer that its shell may reach.
struct Splat {
    ivec4 rectangle; // first pixel and the one after the last, among the sub-buffers
    uint surfel;
};
