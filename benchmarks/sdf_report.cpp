// What libsdformat makes of a model: errors; mass, centre and inertia of its link `base`; frames.
#include <cstdio>
#include <sdf/sdf.hh>

int main(int, char **argv) {
  sdf::Root root;
  for (const auto &error : root.Load(argv[1]))
    std::printf("error %s\n", error.Message().c_str());
  const sdf::Model *model = root.Model();
  if (!model || !model->LinkByName("base")) return 1;
  const auto inertial = model->LinkByName("base")->Inertial();
  const auto centre = inertial.Pose().Pos();
  // About the centre of mass, along the axes of the link.
  const auto moments = inertial.Moi();
  std::printf("mass %.17g\n", inertial.MassMatrix().Mass());
  std::printf("centre %.17g %.17g %.17g\n", centre.X(), centre.Y(), centre.Z());
  for (int i = 0; i < 3; ++i)
    std::printf("inertia %.17g %.17g %.17g\n", moments(i, 0), moments(i, 1), moments(i, 2));
  for (uint64_t k = 0; k < model->FrameCount(); ++k) {
    const sdf::Frame *frame = model->FrameByIndex(k);
    ignition::math::Pose3d at;
    for (const auto &error : frame->SemanticPose().Resolve(at, "base"))
      std::printf("error %s\n", error.Message().c_str());
    std::printf("frame %s %.17g %.17g %.17g\n", frame->Name().c_str(), at.Pos().X(), at.Pos().Y(),
                at.Pos().Z());
  }
}
