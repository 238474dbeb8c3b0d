// Tiles of the picture. What a tile sees at two depths far apart is two groups, each with cells of its own.
const int TILE = 16;

struct Group {
    vec4 sphere;   // around the receivers
    vec4 normal;   // their mean, and the cosine of the angle to the farthest
    float behind;  // the least dot(normal, receiver)
    float count;   // of receivers; 0: none
    float axis;    // along which the tile is divided; -1: it is not
    float divide;  // at which coordinate
};
