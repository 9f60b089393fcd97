//! What is seen and how: camera, lights, materials, and the plan of effects that the scene calls for.
