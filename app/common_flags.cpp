// SPDX-License-Identifier: Apache-2.0
#include "satsurf/app/common_flags.h"

namespace satsurf::app {

CLI::App* add_command(CLI::App& app, CommonFlags& common, const std::string& name,
                      const std::string& about) {
  CLI::App* command = app.add_subcommand(name, about);
  command->add_option("--threads", common.threads, "most threads to use, 0 for all cores")
      ->type_name("N")
      ->capture_default_str()
      ->check(CLI::Range(0, 4096).description(""));
  command->add_flag("--quiet", common.quiet, "nothing but warnings and errors on stderr");
  command
      ->add_option("--log-level", common.log_level,
                   "what to tell: error, warning, info (progress) or debug (times)")
      ->type_name("LEVEL")
      ->capture_default_str();
  command
      ->add_option("--log-file", common.log_file,
                   "add the messages, each with its time, to the end of this file")
      ->type_name("FILE");
  return command;
}

}  // namespace satsurf::app
