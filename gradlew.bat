@rem Windows: the first call of gradlew in a POSIX shell (Git has one) fetches and checks the wrapper; then this works too.
@java -cp "%~dp0gradle-wrapper\gradle-wrapper.jar" org.gradle.wrapper.GradleWrapperMain -p "%~dp0android" %*
